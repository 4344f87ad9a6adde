//! What `--artifacts` says: a folder, or a bucket of S3.

use super::bucket::{Bucket, Patience};
use super::folder::Folder;
use super::{Artifacts, Place};
use crate::{Error, Result};
use object_store::path::Path as Key;
use std::path::Path;

/// What works, for whoever named something else.
const WORKS: &str = "name a folder, file:///its/path, or s3://bucket/prefix";

impl Artifacts {
    /// In a folder (`/srv/flip`, `file:///srv/flip`) or in a bucket (`s3://bucket/prefix`), whose
    /// server and keys are in variables: `AWS_ENDPOINT`, `AWS_ACCESS_KEY_ID` and others.
    pub(crate) fn at(
        address: &str,
        variables: impl Iterator<Item = (String, String)>,
        patience: Patience,
    ) -> Result<Self> {
        let wrong = |why: &str| Error::NoArtifacts(format!("{why}: {WORKS}"));
        let place = match address.split_once("://") {
            None if address.trim().is_empty() => return Err(wrong("it is empty")),
            None => Place::Folder(Folder::new(address)),
            Some(("file", path)) => Place::Folder(Folder::new(file_path(path).map_err(wrong)?)),
            Some(("s3", rest)) => {
                let (bucket, prefix) = bucket_and_prefix(rest).map_err(wrong)?;
                Place::Bucket(Bucket::new(bucket, prefix, variables, patience)?)
            }
            // The rest may hold a password.
            Some((scheme, _)) => return Err(wrong(&format!("`{scheme}://` is not known"))),
        };
        Ok(Self { place, is_marked: true })
    }
}

/// The path of a URL without its `file://`.
fn file_path(rest: &str) -> std::result::Result<std::path::PathBuf, &'static str> {
    let path = rest.strip_prefix("localhost").unwrap_or(rest);
    if !path.starts_with('/') {
        return Err("a file:// address names a path on this machine, after a third slash");
    }
    let decoded = Key::from_url_path(path).map_err(|_| "its path is none")?;
    Ok(Path::new("/").join(decoded.as_ref()))
}

fn bucket_and_prefix(rest: &str) -> std::result::Result<(&str, Key), &'static str> {
    if rest.contains(['@', '?', '#']) {
        return Err(
            "an s3:// address holds a bucket and a prefix only; keys belong in AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
        );
    }
    let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
    let is_name = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'.' | b'-' | b'_');
    if !(3..=63).contains(&bucket.len()) || !bucket.bytes().all(is_name) {
        return Err("the name of a bucket has 3 to 63 lowercase letters, digits, dots and hyphens");
    }
    Ok((bucket, Key::parse(prefix).map_err(|_| "its prefix is none")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(address: &str) -> Result<Artifacts> {
        let keys = [("AWS_ACCESS_KEY_ID", "lab"), ("AWS_SECRET_ACCESS_KEY", "hush")];
        let keys = keys.map(|(name, value)| (name.to_owned(), value.to_owned()));
        Artifacts::at(address, keys.into_iter(), Patience::default())
    }

    #[test]
    fn folders_and_buckets_are_told_apart_and_anything_else_is_refused_with_what_works() {
        for (address, shown) in [
            ("flip-files", "flip-files"),
            ("/srv/flip files", "/srv/flip files"),
            ("file:///srv/flip%20files", "/srv/flip files"),
            ("file://localhost/srv/flip", "/srv/flip"),
            ("s3://lab", "s3://lab"),
            ("s3://lab/", "s3://lab"),
            ("s3://lab-1/flip/north/", "s3://lab-1/flip/north"),
        ] {
            assert_eq!(at(address).unwrap().to_string(), shown);
        }
        for (address, why) in [
            ("gs://lab/flip", "`gs://` is not known"),
            ("https://key:hush@minio.lab/flip", "`https://` is not known"),
            ("s3://key:hush@lab/flip", "AWS_ACCESS_KEY_ID"),
            ("s3://lab/flip?secret=hush", "a bucket and a prefix only"),
            ("s3:///flip", "3 to 63"),
            ("s3://Lab/flip", "lowercase"),
            ("s3://lab/a//b", "prefix"),
            ("file://nas/flip", "on this machine"),
            (" ", "empty"),
        ] {
            let refused = at(address).unwrap_err().to_string();
            assert!(refused.contains(why) && refused.contains(WORKS), "{address}: {refused}");
            assert!(!refused.contains("hush"), "{refused}");
        }
    }

    #[test]
    fn a_key_is_never_shown() {
        let shown = format!("{:?}", at("s3://lab/flip").unwrap());
        assert!(shown.contains("s3://lab/flip") && !shown.contains("hush"), "{shown}");
    }
}
