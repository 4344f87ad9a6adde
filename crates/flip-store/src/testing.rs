//! A store for a test, on the database that the tests run on.

use super::{Result, Storage, Store};
use std::path::Path;

pub(super) use flip_testing::{Cluster, cluster, on_postgres, only_sqlite_has};

/// Open the store of this data folder; on PostgreSQL each folder has a database of its own.
pub(super) async fn open(data_dir: &Path) -> Result<Store> {
    Store::open(storage(data_dir).await).await
}

/// Open the database at this address, whatever the tests run on.
pub(super) async fn open_on(database_url: &str, data_dir: &Path) -> Result<Store> {
    Store::open(Storage::on_server(database_url, data_dir)?).await
}

/// Where the store of this data folder is.
pub(super) async fn storage(data_dir: &Path) -> Storage {
    match flip_testing::database_url(data_dir).await {
        Some(url) => Storage::on_server(&url, data_dir).unwrap(),
        None => data_dir.into(),
    }
}

/// Take a trigger away, as nobody but an administrator of the database can.
pub(super) async fn drop_trigger(store: &Store, trigger: &str, table: &str) {
    flip_testing::drop_trigger(store.writer().unwrap(), trigger, table).await;
}
