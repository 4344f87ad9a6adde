use super::*;
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use flip_store::tokens::Role;
use jsonwebtoken::get_current_timestamp;
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, KeyPair};
use serde_json::json;

/// A key of a provider, made for one test.
struct Key(EcdsaKeyPair);

impl Key {
    fn new() -> Self {
        let (random, of) = (SystemRandom::new(), &ECDSA_P256_SHA256_FIXED_SIGNING);
        let pkcs8 = EcdsaKeyPair::generate_pkcs8(of, &random).unwrap();
        Self(EcdsaKeyPair::from_pkcs8(of, pkcs8.as_ref(), &random).unwrap())
    }

    fn public(&self, id: &str) -> Value {
        let (x, y) = self.0.public_key().as_ref()[1..].split_at(32);
        json!({ "kty": "EC", "crv": "P-256", "use": "sig", "kid": id, "x": text(x), "y": text(y) })
    }

    fn sign(&self, header: &Value, claims: &Value) -> String {
        let said = format!("{}.{}", text(header.to_string()), text(claims.to_string()));
        let signature = self.0.sign(&SystemRandom::new(), said.as_bytes()).unwrap();
        format!("{said}.{}", text(signature.as_ref()))
    }
}

fn text(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

fn settings() -> OidcSettings {
    OidcSettings {
        issuer: "https://id.example.org".into(),
        client_id: "flip".into(),
        client_secret: "secret".into(),
        redirect_url: "https://flip.example.org/".into(),
        scopes: "openid".into(),
        role_claim: "groups".into(),
        roles: vec![(Role::Operator, "balance".into())],
    }
}

fn claims() -> Value {
    json!({ "iss": "https://id.example.org", "aud": "flip", "sub": "17", "nonce": "n", "name": "Ada",
        "exp": get_current_timestamp() + 300, "groups": ["balance", "staff"] })
}

/// Verifies these claims, signed and published by one key.
fn verified(claims: &Value) -> Result<Person, String> {
    let key = Key::new();
    let keys = Keys { keys: vec![json!({ "kty": "odd" }), key.public("1")] };
    verify(&key.sign(&json!({ "alg": "ES256", "kid": "1" }), claims), &keys, &settings(), "n")
}

fn but(field: &str, value: Value) -> Value {
    let mut claims = claims();
    claims[field] = value;
    claims
}

#[test]
fn a_sound_token_names_a_person_and_the_groups() {
    let found = verified(&claims()).unwrap();
    let groups = vec!["balance".to_owned(), "staff".to_owned()];
    assert_eq!(found, Person { subject: "17".into(), name: "Ada".into(), groups });
    assert_eq!(verified(&but("groups", json!("balance"))).unwrap().groups, ["balance"]);
    assert!(verified(&but("groups", json!({ "balance": true }))).unwrap().groups.is_empty());
    assert_eq!(verified(&but("name", json!(" \n"))).unwrap().name, "17", "a blank name is none");
    assert_eq!(verified(&but("name", json!("a".repeat(300)))).unwrap().name.len(), 100);
    let shared = json!({ "aud": ["flip", "other"], "azp": "flip" });
    let mut claims = claims();
    claims.as_object_mut().unwrap().extend(shared.as_object().unwrap().clone());
    verified(&claims).unwrap();
}

#[test]
fn every_claim_that_could_deceive_is_refused_for_its_own_reason() {
    for (field, value, reason) in [
        ("iss", json!("https://evil.example"), "somebody else"),
        ("iss", json!(["https://id.example.org", "https://evil.example"]), "somebody else"),
        ("iss", Value::Null, "iss"),
        ("aud", json!("other"), "another program"),
        ("aud", json!(["flip", "other"]), "another program"),
        ("aud", Value::Null, "aud"),
        ("azp", json!("other"), "another program"),
        ("exp", json!(get_current_timestamp() - 120), "expired"),
        ("exp", json!("tomorrow"), "exp"),
        ("exp", Value::Null, "exp"),
        ("nbf", json!(get_current_timestamp() + 600), "not valid yet"),
        ("nonce", json!("m"), "another log-in"),
        ("nonce", Value::Null, "another log-in"),
        ("sub", Value::Null, "sub"),
    ] {
        let why = verified(&but(field, value.clone())).unwrap_err();
        assert!(why.contains(reason), "{field} {value}: {why}");
    }
}

#[test]
fn only_a_signature_by_a_published_key_counts() {
    let (ours, other) = (Key::new(), Key::new());
    let keys = Keys { keys: vec![ours.public("1"), other.public("2")] };
    let why = |token: &str| verify(token, &keys, &settings(), "n").unwrap_err();
    let header = |alg: &str, kid: &str| json!({ "alg": alg, "kid": kid });
    assert!(why(&other.sign(&header("ES256", "1"), &claims())).contains("signature"));
    assert!(why(&ours.sign(&header("ES256", "3"), &claims())).contains("does not publish"));
    // A key of one kind must not verify a signature of another, and a public key is no secret.
    assert!(why(&ours.sign(&header("RS256", "1"), &claims())).contains("ID token"));
    assert!(why(&ours.sign(&header("HS256", "1"), &claims())).contains("RS256 and ES256"));
    assert!(why(&ours.sign(&header("none", "1"), &claims())).contains("not one"));
    assert!(why("a.b").contains("not one"));
    let token = ours.sign(&header("ES256", "1"), &claims());
    let parts: Vec<&str> = token.split('.').collect();
    let forged = text(but("groups", json!(["admins"])).to_string());
    assert!(why(&format!("{}.{forged}.{}", parts[0], parts[2])).contains("signature"));
    let sound = verify(&ours.sign(&json!({ "alg": "ES256" }), &claims()), &keys, &settings(), "n");
    assert!(sound.is_ok(), "without a key id, every key is tried");
    let encrypts = Keys {
        keys: vec![{
            let mut key = ours.public("1");
            key["use"] = "enc".into();
            key
        }],
    };
    assert!(
        verify(&token, &encrypts, &settings(), "n").is_err(),
        "a key for encryption signs nothing"
    );
}

/// The example of RFC 7515, appendix A.2.
#[test]
fn an_rsa_signature_made_elsewhere_is_verified() {
    let key = json!({ "kty": "RSA", "e": "AQAB", "n": "ofgWCuLjybRlzo0tZWJjNiuSfb4p4fAkd_wWJcyQoTbji9k0l8W26mPddxHmfHQp-Vaw-4qPCJrcS2mJPMEzP1Pt0Bm4d4QlL-yRT-SFd2lZS-pCgNMsD1W_YpRPEwOWvG6b32690r2jZ47soMZo9wGzjb_7OMg0LOL-bSf63kpaSHSXndS5z5rexMdbBYUsLA9e-KXBdQOS-UTo7WTBEMa2R2CapHg665xsmtdVMTBQY4uDZlxvb3qCo5ZwKh9kG4LT6_I5IhlJH7aGhyxXFvUK-DWNmoudF8NAco9_h9iaGNj8q2ethFkMLs91kzk2PAcDTW9gb54h4FRWyuXpoQ" });
    let said = b"eyJhbGciOiJSUzI1NiJ9.eyJpc3MiOiJqb2UiLA0KICJleHAiOjEzMDA4MTkzODAsDQogImh0dHA6Ly9leGFtcGxlLmNvbS9pc19yb290Ijp0cnVlfQ";
    let signature = "cC4hiUPoj9Eetdgtv3hF80EGrhuB__dzERat0XF9g2VtQgr9PJbu3XOiZj5RZmh7AAuHIm4Bh-0Qc_lF5YKt_O8W2Fp5jujGbds9uJdbF9CUAr7t1dnZcAcQjbKBYNX4BAynRFdiuB--f_nZLgrnbyTyWzO75vRK5h6xBArLIARNPvkSjtQBMHlb1L07Qe7K0GarZRmB_eSN9383LcOLn6_dO--xi12jzDwusC-eOkHWEsqtFZESc6BfI7noOPqvhJ1phCnvWh6IeYI2w9QOYEUipUTI8np6LbgGY9Fs98rqVt5AXLIhWkWywlVmtVrBp0igcN_IoypGlUPQGe77Rw";
    let keys = Keys { keys: vec![key] };
    let key = keys.signing(None).next().unwrap();
    let verifier = ByRing { algorithm: Algorithm::RS256, key };
    let mut signature = URL_SAFE_NO_PAD.decode(signature).unwrap();
    assert!(verifier.verify(said, &signature).is_ok());
    signature[9] ^= 1;
    assert!(verifier.verify(said, &signature).is_err());
}
