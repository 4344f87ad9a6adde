use super::*;

fn settings() -> OidcSettings {
    OidcSettings {
        issuer: "https://id.example.org/realms/lab".into(),
        client_id: "flip".into(),
        client_secret: "secret".into(),
        redirect_url: "https://flip.example.org/".into(),
        scopes: "openid profile".into(),
        role_claim: "groups".into(),
        roles: vec![(Role::Viewer, "staff".into())],
    }
}

#[test]
fn settings_that_cannot_work_are_all_named() {
    Oidc::new(settings()).unwrap();
    let here = "http://127.0.0.1:8080/".to_owned();
    Oidc::new(OidcSettings { redirect_url: here, ..settings() }).unwrap();
    let wrong = OidcSettings {
        issuer: "http://id.example.org".into(),
        client_id: String::new(),
        client_secret: "\n".into(),
        redirect_url: "https://flip.example.org/callback".into(),
        scopes: "profile".into(),
        role_claim: String::new(),
        roles: Vec::new(),
    };
    let Err(Error::Invalid(errors)) = Oidc::new(wrong) else { panic!() };
    let fields: Vec<&str> = errors.iter().map(|it| it.field.as_str()).collect();
    assert_eq!(
        fields,
        [
            "oidc_issuer",
            "oidc_redirect_url",
            "oidc_client_id",
            "oidc_client_secret_file",
            "oidc_role_claim",
            "oidc_scopes",
            "oidc_role"
        ]
    );
    for unsafe_address in [
        "ftp://id.example.org",
        "https://",
        "id.example.org",
        "https://me:secret@id.example.org",
        "https://id.example.org/#x",
        "http://127.0.0.1.example.org",
    ] {
        assert!(address("oidc_issuer", unsafe_address).is_err(), "{unsafe_address}");
    }
}

fn begun(secret: &str, at: Instant) -> Begun {
    Begun { secret: secret.into(), nonce: "n".into(), verifier: "v".into(), at }
}

fn answer(state: &str, secret: &str) -> LogInAnswer {
    LogInAnswer { state: state.into(), code: "c".into(), secret: secret.into() }
}

#[test]
fn a_log_in_is_finished_once_by_whoever_began_it_and_in_time() {
    let oidc = Oidc::new(settings()).unwrap();
    let state = oidc.remember(begun("s", Instant::now())).unwrap();
    assert!(oidc.take(&answer(&state, "s")).is_some());
    assert!(oidc.take(&answer(&state, "s")).is_none(), "twice");
    let state = oidc.remember(begun("s", Instant::now())).unwrap();
    assert!(oidc.take(&answer(&state, "other")).is_none(), "somebody else's");
    assert!(oidc.take(&answer(&state, "s")).is_none(), "used up by whoever guessed");
    let late = Instant::now().checked_sub(PATIENCE).unwrap();
    let state = oidc.remember(begun("s", late)).unwrap();
    assert!(oidc.take(&answer(&state, "s")).is_none(), "too late");
}

#[test]
fn whoever_begins_log_ins_without_end_fills_no_memory() {
    let oidc = Oidc::new(settings()).unwrap();
    let first = oidc.remember(begun("s", Instant::now())).unwrap();
    for _ in 0..UNDER_WAY_MAX {
        oidc.remember(begun("s", Instant::now())).unwrap();
    }
    assert_eq!(oidc.0.under_way.lock().unwrap().len(), UNDER_WAY_MAX);
    assert!(oidc.take(&answer(&first, "s")).is_none(), "the oldest goes");
}
