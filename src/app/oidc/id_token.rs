//! Verifies an ID token: its signature, who issued it, for whom, until when, and for which log-in.

use super::OidcSettings;
use jsonwebtoken::crypto::{CryptoProvider, JwtVerifier, KeyUtils};
use jsonwebtoken::errors::{Error as JwtError, ErrorKind};
use jsonwebtoken::jwk::{Jwk, PublicKeyUse};
use jsonwebtoken::signature::{Error as NotSound, Verifier};
use jsonwebtoken::{
    Algorithm, AlgorithmFamily, DecodingKey, DecodingKeyKind, Validation, decode, decode_header,
};
use ring::signature::{
    ECDSA_P256_SHA256_FIXED, RSA_PKCS1_2048_8192_SHA256, RsaPublicKeyComponents, UnparsedPublicKey,
};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Longest name of a token.
const NAME_CHARS_MAX: usize = 100;

/// The keys that a provider signs with (JWKS).
#[derive(Deserialize)]
pub(super) struct Keys {
    /// Read one by one: a key of a kind that FLIP does not know must not hide the others.
    keys: Vec<Value>,
}

/// Whom an ID token is about.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Person {
    /// The provider's own name for the person, which never changes.
    pub subject: String,
    /// The name to show.
    pub name: String,
    pub groups: Vec<String>,
}

/// The person, or why the token cannot be trusted.
pub(super) fn verify(
    token: &str,
    keys: &Keys,
    settings: &OidcSettings,
    nonce: &str,
) -> Result<Person, String> {
    // Once per process; a second call changes nothing.
    let _installed = RING.install_default();
    let header = decode_header(token).map_err(|error| why(&error))?;
    let mut rules = Validation::new(Algorithm::RS256);
    rules.algorithms = vec![header.alg];
    if !matches!(header.alg, Algorithm::RS256 | Algorithm::ES256) {
        return Err(format!(
            "its ID token is signed by {:?}, and FLIP reads RS256 and ES256: change the client's setting there",
            header.alg
        ));
    }
    rules.set_issuer(&[&settings.issuer]);
    rules.set_audience(&[&settings.client_id]);
    rules.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
    rules.validate_nbf = true;

    let mut refusal = "its ID token is signed by a key that it does not publish".to_owned();
    for key in keys.signing(header.kid.as_deref()) {
        match decode::<Map<String, Value>>(token, &key, &rules) {
            Ok(sound) => return person(&sound.claims, settings, nonce),
            Err(error) => refusal = why(&error),
        }
    }
    Err(refusal)
}

/// The rules of OpenID Connect beyond those of a signed token.
fn person(
    claims: &Map<String, Value>,
    settings: &OidcSettings,
    nonce: &str,
) -> Result<Person, String> {
    let text = |name: &str| claims.get(name).and_then(Value::as_str);
    // The library also takes lists of issuers.
    if text("iss") != Some(&settings.issuer) {
        return Err(why(&ErrorKind::InvalidIssuer.into()));
    }
    if text("nonce") != Some(nonce) {
        return Err("its ID token belongs to another log-in (nonce)".to_owned());
    }
    let is_for_several = claims.get("aud").and_then(Value::as_array).is_some_and(|it| it.len() > 1);
    match text("azp") {
        Some(client) if client != settings.client_id => {
            return Err(why(&ErrorKind::InvalidAudience.into()));
        }
        None if is_for_several => return Err(why(&ErrorKind::InvalidAudience.into())),
        _ => {}
    }
    let subject = text("sub").unwrap_or_default().to_owned();
    let names = ["name", "preferred_username", "email", "sub"];
    let names = names.iter().filter_map(|claim| text(claim)).map(shown);
    let name = names.into_iter().find(|name| !name.is_empty());
    Ok(Person {
        name: name.ok_or("its ID token names nobody")?,
        subject,
        groups: groups(claims.get(&settings.role_claim)),
    })
}

/// One group, or a list of them.
fn groups(claim: Option<&Value>) -> Vec<String> {
    match claim {
        Some(Value::String(one)) => vec![one.clone()],
        Some(Value::Array(all)) => {
            all.iter().filter_map(|it| it.as_str().map(str::to_owned)).collect()
        }
        _ => Vec::new(),
    }
}

/// A name as a token may have it.
fn shown(name: &str) -> String {
    let name: String = name.chars().filter(|c| !c.is_control()).take(NAME_CHARS_MAX).collect();
    name.trim().to_owned()
}

fn why(error: &JwtError) -> String {
    let told = match error.kind() {
        ErrorKind::InvalidSignature => "the signature of its ID token is wrong",
        ErrorKind::ExpiredSignature => {
            "its ID token has expired; compare the clocks of both machines"
        }
        ErrorKind::ImmatureSignature => {
            "its ID token is not valid yet; compare the clocks of both machines"
        }
        ErrorKind::InvalidIssuer => "its ID token was issued by somebody else",
        ErrorKind::InvalidAudience => "its ID token is for another program",
        other => return format!("its ID token is not one ({other:?})"),
    };
    told.to_owned()
}

impl Keys {
    /// The keys that may have signed a token with this key id; all that sign, if it names none.
    fn signing(&self, id: Option<&str>) -> impl Iterator<Item = DecodingKey> {
        let keys = self.keys.iter().filter_map(|key| Jwk::deserialize(key).ok());
        let fits = move |key: &Jwk| {
            key.common.public_key_use != Some(PublicKeyUse::Encryption)
                && (id.is_none() || key.common.key_id.as_deref() == id)
        };
        keys.filter(fits).filter_map(|key| DecodingKey::from_jwk(&key).ok())
    }
}

/// Signatures are verified by ring, which serves TLS as well; FLIP signs nothing.
static RING: CryptoProvider = CryptoProvider {
    signer_factory: |_, _| Err(ErrorKind::UnsupportedAlgorithm.into()),
    verifier_factory: |algorithm, key| {
        Ok(Box::new(ByRing { algorithm: *algorithm, key: key.clone() }))
    },
    key_utils: KeyUtils::new_unimplemented(),
};

struct ByRing {
    algorithm: Algorithm,
    key: DecodingKey,
}

impl JwtVerifier for ByRing {
    fn algorithm(&self) -> Algorithm {
        self.algorithm
    }
}

impl Verifier<Vec<u8>> for ByRing {
    fn verify(&self, message: &[u8], signature: &Vec<u8>) -> Result<(), NotSound> {
        // A key counts for its own kind of signature only.
        let verified = match (self.algorithm, self.key.family(), self.key.kind()) {
            (
                Algorithm::RS256,
                AlgorithmFamily::Rsa,
                DecodingKeyKind::RsaModulusExponent { n, e },
            ) => RsaPublicKeyComponents { n, e }.verify(
                &RSA_PKCS1_2048_8192_SHA256,
                message,
                signature,
            ),
            (Algorithm::ES256, AlgorithmFamily::Ec, DecodingKeyKind::SecretOrDer(point)) => {
                UnparsedPublicKey::new(&ECDSA_P256_SHA256_FIXED, point).verify(message, signature)
            }
            _ => return Err(NotSound::new()),
        };
        verified.map_err(|_| NotSound::new())
    }
}

#[cfg(test)]
mod tests;
