//! The minimum role of each method, known before a message is awaited or decoded.
//!
//! Every method checks its role itself; this is a first filter, so it may require less but never
//! more.

use super::DESCRIPTORS;
use crate::app::Role;
use prost::Message;
use prost_types::FileDescriptorSet;
use std::collections::HashMap;
use std::sync::LazyLock;

/// Prefixes of the names of read-only methods.
const READING: [&str; 7] = ["Get", "List", "Read", "Watch", "Compare", "Verify", "Download"];
/// The services reserved for admins.
const TOKENS: &str = "Tokens";
const WEBHOOKS: &str = "Webhooks";
/// Its method for every caller.
const IDENTITY: &str = "GetIdentity";
/// Its methods for people who have no token yet.
const LOG_IN: [&str; 3] = ["GetLogIn", "BeginLogIn", "FinishLogIn"];

/// Who may call a method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Anybody: health and reflection.
    Anybody,
    /// Anybody: log-ins.
    LogIn,
    /// Callers with at least this role.
    Least(Role),
}

/// Every method of `flip.v1`, by path.
static METHODS: LazyLock<HashMap<String, Access>> = LazyLock::new(|| {
    let files = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default().file;
    let services = files.into_iter().flat_map(|file| {
        let package = file.package().to_owned();
        file.service.into_iter().map(move |service| (package.clone(), service))
    });
    let methods = services.flat_map(|(package, service)| {
        let name = service.name().to_owned();
        service.method.into_iter().map(move |method| {
            let path = format!("/{package}.{name}/{}", method.name());
            (path, access_of(&name, method.name()))
        })
    });
    methods.collect()
});

fn access_of(service: &str, method: &str) -> Access {
    match READING.iter().any(|word| method.starts_with(word)) {
        _ if service == TOKENS && LOG_IN.contains(&method) => Access::LogIn,
        _ if service == TOKENS && method != IDENTITY => Access::Least(Role::Admin),
        _ if service == WEBHOOKS => Access::Least(Role::Admin),
        true => Access::Least(Role::Viewer),
        false => Access::Least(Role::Operator),
    }
}

/// Who may call the method at this path; `None` if there is no such method.
pub fn access(path: &str) -> Option<Access> {
    if path.starts_with("/grpc.health.v1.") || path.starts_with("/grpc.reflection.") {
        return Some(Access::Anybody);
    }
    METHODS.get(path).copied()
}

/// The paths of all methods of `flip.v1`.
pub fn methods() -> impl Iterator<Item = &'static str> {
    METHODS.keys().map(String::as_str)
}

/// Whether a method keeps reading messages while it answers, so that they cannot be awaited first.
pub fn listens(path: &str) -> bool {
    path.ends_with("/ServerReflectionInfo")
}

/// Whether a method answers with events for as long as they arrive.
pub fn streams(path: &str) -> bool {
    listens(path) || path.rsplit('/').next().is_some_and(|method| method.starts_with("Watch"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_the_arm_needs_an_operator_and_what_is_not_there_has_no_role() {
        assert_eq!(access("/flip.v1.Weighings/StartWeighing"), Some(Access::Least(Role::Operator)));
        assert_eq!(access("/flip.v1.Simulators/Predict"), Some(Access::Least(Role::Operator)));
        assert_eq!(access("/flip.v1.Weighings/GetWeighing"), Some(Access::Least(Role::Viewer)));
        assert_eq!(access("/grpc.health.v1.Health/Check"), Some(Access::Anybody));
        assert_eq!(access("/flip.v1.Tokens/FinishLogIn"), Some(Access::LogIn));
        assert_eq!(access("/flip.v1.Tokens/ListTokens"), Some(Access::Least(Role::Admin)));
        assert_eq!(access("/flip.v1.Weighings/Nothing"), None);
        assert!(METHODS.len() >= 54, "{}", METHODS.len());
    }
}
