//! Powders, measurements, tokens, and who may open what.

use crate::harness::{functions, open, storage};
use flip::app::{
    App, Error, Flowability, Method, NewMeasurement, NewPowder, OpenError, Options, PageQuery, Role,
};

fn measurement(repose_deg: f64, method: Method) -> NewMeasurement {
    NewMeasurement {
        method,
        repose_deg: Some(repose_deg),
        sd_deg: Some(1.0),
        n: Some(5),
        repeats_deg: None,
        heights_mm: None,
        base_diameters_mm: None,
        funnel_height_mm: None,
        source: None,
        measured_on: None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_published_powders_are_there_with_both_measurements() {
    let (_folder, app) = open(functions()).await;
    let powders = app.powders(PageQuery::default()).await.unwrap().items;
    let ids: Vec<&str> = powders.iter().map(|powder| powder.id.as_str()).collect();
    assert_eq!(ids, ["sand", "sugar", "salt", "semolina", "sodium_bicarbonate"]);
    assert_eq!(
        powders[3].flowability,
        Some(Flowability { repose_deg: 42.762, sd_deg: 1.97, n: 5 })
    );
    let detail = app.powder("salt").await.unwrap();
    let measured: Vec<f64> = detail.measurements.iter().map(|m| m.repose_deg).collect();
    assert_eq!(measured, [36.03, 35.80]);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_automated_measurement_is_the_one_to_aim_at() {
    let (_folder, app) = open(functions()).await;
    app.create_powder(NewPowder {
        id: "flour".into(),
        name: "Flour".into(),
        soluble: None,
        measurement: None,
    })
    .await
    .unwrap();
    let aim = async || app.powder("flour").await.unwrap().powder.flowability.map(|f| f.repose_deg);
    assert_eq!(aim().await, None);
    for (repose_deg, method, expected) in [
        (50.0, Method::Manual, 50.0),
        (48.0, Method::Automated, 48.0),
        (51.0, Method::Manual, 48.0),
        (47.0, Method::Automated, 47.0),
    ] {
        app.add_measurement("flour", measurement(repose_deg, method)).await.unwrap();
        assert_eq!(aim().await, Some(expected));
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn powders_that_are_taken_or_misnamed_and_impossible_measurements_are_refused() {
    let (_folder, app) = open(functions()).await;
    let create = async |id: &str, name: &str| {
        app.create_powder(NewPowder {
            id: id.into(),
            name: name.into(),
            soluble: None,
            measurement: None,
        })
        .await
    };
    assert!(matches!(
        create("sand", "Sand").await,
        Err(Error::Conflict { code: "powder_exists", .. })
    ));
    let Err(Error::Invalid(fields)) = create("Sand!", " ").await else { panic!("accepted") };
    assert_eq!(fields.iter().map(|f| f.field.as_str()).collect::<Vec<_>>(), ["id", "name"]);
    let Err(Error::Invalid(fields)) =
        app.add_measurement("sand", measurement(f64::NAN, Method::Manual)).await
    else {
        panic!("accepted")
    };
    assert_eq!(fields[0].field, "repose_deg");
    let unknown = app.add_measurement("flour", measurement(40.0, Method::Manual)).await;
    assert!(matches!(unknown, Err(Error::NotFound { what: "powder", .. })));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_are_read_page_by_page_without_a_gap() {
    let (_folder, app) = open(functions()).await;
    let mut seen = Vec::new();
    let mut after = None;
    loop {
        let page =
            app.powders(PageQuery { limit: Some(2), after, ..PageQuery::default() }).await.unwrap();
        seen.extend(page.items.into_iter().map(|powder| powder.id));
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!(seen, ["sand", "sugar", "salt", "semolina", "sodium_bicarbonate"]);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_opens_what_its_role_may_and_nothing_else_does() {
    let (_folder, app) = open(functions()).await;
    assert!(!app.has_tokens().await.unwrap());
    let secret = app.create_token("bench 1", Role::Operator).await.unwrap();
    assert!(app.has_tokens().await.unwrap());
    assert_eq!(app.authenticate(&secret).map(|holder| holder.role), Some(Role::Operator));
    let mut other = secret.clone();
    other.replace_range(secret.len() - 1.., if secret.ends_with('0') { "1" } else { "0" });
    for wrong in
        [other.as_str(), &secret[..secret.len() - 1], "flip_", "", "flip_0000000000000000_00"]
    {
        assert_eq!(app.authenticate(wrong), None, "{wrong}");
    }
    assert!(Role::Viewer < Role::Operator && Role::Operator < Role::Admin);
    assert!(matches!(app.create_token("", Role::Admin).await, Err(Error::Invalid(_))));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_in_use_is_refused_for_writing_and_open_for_reading() {
    let (folder, app) = open(functions()).await;
    let second = App::open(storage(folder.path()).await, Options::default()).await;
    let Err(OpenError::Held(message)) = second else { panic!("opened twice") };
    let told = ["flip serve holds this database", "bench `bench` is served by"];
    assert!(told.iter().any(|it| message.contains(it)), "{message}");
    let reader = App::open_to_read(storage(folder.path()).await).await.unwrap();
    assert_eq!(reader.powders(PageQuery::default()).await.unwrap().items.len(), 5);
    let write = reader
        .create_powder(NewPowder {
            id: "flour".into(),
            name: "Flour".into(),
            soluble: None,
            measurement: None,
        })
        .await;
    assert!(matches!(write, Err(Error::Unavailable(_))), "{write:?}");
    app.shutdown().await.unwrap();
    app.shutdown().await.unwrap();
}
