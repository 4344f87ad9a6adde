//! The features: their identifiers, their definitions, and which calls need an access token.

/// A feature that the server implements.
pub struct Feature {
    /// Fully qualified identifier.
    pub identifier: &'static str,
    /// Its definition, as XML.
    pub definition: &'static str,
    /// Commands for operators; reading is for viewers.
    pub operating: &'static [&'static str],
}

/// Fully qualified identifiers.
pub const SERVICE: &str = "org.silastandard/core/SiLAService/v1";
pub const AUTHENTICATION: &str = "org.silastandard/core/AuthenticationService/v1";
pub const AUTHORIZATION: &str = "org.silastandard/core/AuthorizationService/v1";
pub const CANCEL: &str = "org.silastandard/core.commands/CancelController/v1";
pub const LOCK: &str = "org.silastandard/core/LockController/v1";
pub const WEIGHING: &str = "flip/weighing/PowderWeighing/v1";
pub const BENCH: &str = "flip/weighing/BenchControl/v1";
pub const BALANCE: &str = "flip/weighing/BalanceReading/v1";
pub const REPOSE: &str = "flip/flowability/AngleOfReposeMeasurement/v1";
pub const CALIBRATION: &str = "flip/flowability/PowderCalibration/v1";
pub const DISCOVERY: &str = "flip/discovery/SimulatorDiscovery/v1";

macro_rules! feature {
    ($identifier:ident, $name:literal, $operating:expr) => {
        Feature {
            identifier: $identifier,
            definition: include_str!(concat!("../../../proto/sila/", $name, ".sila.xml")),
            operating: &$operating,
        }
    };
}

/// Every feature; the lock is served on request only.
const ALL: [Feature; 11] = [
    feature!(SERVICE, "SiLAService", []),
    feature!(AUTHENTICATION, "AuthenticationService", []),
    feature!(AUTHORIZATION, "AuthorizationService", []),
    feature!(CANCEL, "CancelController", ["CancelCommand", "CancelAll"]),
    feature!(LOCK, "LockController", ["LockServer", "UnlockServer"]),
    feature!(WEIGHING, "PowderWeighing", ["DosePowder", "ConfirmVial"]),
    feature!(BENCH, "BenchControl", ["Stop", "Clear", "Resume"]),
    feature!(BALANCE, "BalanceReading", ["Tare", "Zero"]),
    feature!(REPOSE, "AngleOfReposeMeasurement", ["MeasureAngleOfRepose", "AddFrame"]),
    feature!(CALIBRATION, "PowderCalibration", ["Calibrate"]),
    feature!(DISCOVERY, "SimulatorDiscovery", ["Investigate"]),
];

/// Calls that need the lock's identifier while the server is locked: those that move something.
/// Stopping needs none.
pub const LOCKED: [(&str, &str); 5] = [
    (WEIGHING, "DosePowder"),
    (WEIGHING, "ConfirmVial"),
    (BALANCE, "Tare"),
    (BALANCE, "Zero"),
    (REPOSE, "MeasureAngleOfRepose"),
];

/// The features of a server, with or without the lock.
pub fn all(with_lock: bool) -> impl Iterator<Item = &'static Feature> {
    ALL.iter().filter(move |feature| with_lock || feature.identifier != LOCK)
}

/// Fully qualified identifier of a command.
pub fn command(feature: &str, command: &str) -> String {
    format!("{feature}/Command/{command}")
}

/// What needs an access token: commands for operators if `reads` are free, else everything but what
/// gives the token and says who the server is.
pub fn guarded(with_lock: bool, reads: bool) -> Vec<String> {
    let free = [SERVICE, AUTHENTICATION, AUTHORIZATION];
    let features = all(with_lock).filter(|it| !free.contains(&it.identifier));
    match reads {
        true => features
            .flat_map(|it| it.operating.iter().map(|name| command(it.identifier, name)))
            .collect(),
        false => features.map(|it| it.identifier.to_owned()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text between the first of these marks.
    fn between<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
        text.split_once(from).unwrap().1.split_once(to).unwrap().0
    }

    #[test]
    fn identifiers_are_those_of_the_definitions() {
        for Feature { identifier, definition, operating } in &ALL {
            let attribute = |name: &str| between(definition, &format!(" {name}=\""), "\"");
            let (originator, category) = (attribute("Originator"), attribute("Category"));
            let version = attribute("FeatureVersion").split('.').next().unwrap();
            let name = between(definition, "<Identifier>", "</Identifier>");
            assert_eq!(*identifier, format!("{originator}/{category}/{name}/v{version}"));
            for command in *operating {
                let begins = format!("<Identifier>{command}</Identifier>");
                assert!(definition.contains(&begins), "{identifier}: {command}");
            }
        }
    }

    #[test]
    fn what_names_the_server_and_gives_tokens_is_free() {
        for it in guarded(true, false).iter().chain(&guarded(true, true)) {
            assert!(![SERVICE, AUTHENTICATION, AUTHORIZATION].iter().any(|free| it.contains(free)));
        }
        assert!(guarded(false, true).contains(&command(WEIGHING, "DosePowder")));
        assert!(!guarded(false, true).iter().any(|it| it.contains("GetWeighing")));
        assert!(!guarded(false, false).contains(&LOCK.to_owned()));
    }
}
