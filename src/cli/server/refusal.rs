//! A server's refusal, as the error that the application here would give.

use crate::api::problem::Problem;
use crate::app::Error;
use flip_core::domain::FieldError;

/// The error behind an answer with a status of 300 or more.
pub(super) fn refusal(url: &str, status: u16, body: &[u8]) -> Error {
    match serde_json::from_slice::<Problem>(body) {
        Ok(problem) => of_problem(url, problem),
        Err(_) => Error::Unavailable(format!(
            "{url} answers with status {status}, and not as FLIP does: check the address and the path in it"
        )),
    }
}

fn of_problem(url: &str, problem: Problem) -> Error {
    let Problem { kind, status, detail, errors, instance, .. } = problem;
    let kind = kind.rsplit(':').next().unwrap_or_default();
    match status {
        _ if !errors.is_empty() => {
            let field = |it: crate::api::wire::FieldError| FieldError::new(it.field, it.message);
            Error::Invalid(errors.into_iter().map(field).collect())
        }
        401 => Error::Refused(format!(
            "{url} does not accept this: {detail}. FLIP_TOKEN, or the file of --token-file, has to hold a token of that server"
        )),
        403 => Error::Refused(format!(
            "{url} does not allow this: {detail}. FLIP_TOKEN, or the file of --token-file, has to hold a token of that role"
        )),
        404 => FieldError::new(missing(&detail), detail.clone()).into(),
        409 if kind == "queue-full" => Error::Busy(detail),
        // What a missing calibration leads to depends on its code.
        409 if kind == "calibration-missing" => Error::conflict("calibration_missing", detail),
        409 | 422 => Error::conflict("refused", detail),
        410 => Error::Lost(detail),
        400 | 405 | 413 | 415 => {
            FieldError::new("server", format!("{url} does not take the request: {detail}")).into()
        }
        500 => {
            let instance = instance.unwrap_or_default();
            Error::Unavailable(format!("{url}: {detail} ({instance})"))
        }
        _ => Error::Unavailable(format!("{url}: {detail}")),
    }
}

/// What there is none of, in ``there is no powder `chalk` ``.
fn missing(detail: &str) -> &str {
    let what = detail.strip_prefix("there is no ").and_then(|rest| rest.split_once(" `"));
    what.map_or("server", |(what, _)| what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app;

    fn back(error: Error) -> Error {
        let problem = Problem::from(error);
        refusal("http://lab", problem.status, &serde_json::to_vec(&problem).unwrap())
    }

    #[test]
    fn a_refusal_comes_back_as_the_error_that_it_was() {
        let wrong = FieldError::new("target.value", "must be at most 30 mg");
        assert!(matches!(back(wrong.into()), Error::Invalid(it) if it[0].field == "target.value"));
        let Error::Invalid(missing) = back(Error::not_found("policy", "p-0")) else { panic!() };
        assert_eq!(missing[0].to_string(), "policy: there is no policy `p-0`");
        let conflict = back(Error::conflict("calibration_missing", "no sets"));
        assert!(
            matches!(&conflict, Error::Conflict { code: "calibration_missing", message } if message == "no sets")
        );
        assert!(matches!(back(Error::conflict("bench_held", "x")), Error::Conflict { .. }));
        assert!(matches!(back(app::Error::Busy("full".into())), Error::Busy(_)));
        assert!(matches!(back(app::Error::Lost("gone".into())), Error::Lost(_)));
    }

    #[test]
    fn a_missing_right_names_where_the_token_comes_from() {
        let refused = back(Error::TokenEnded).to_string();
        assert!(refused.contains("FLIP_TOKEN") && refused.contains("http://lab"), "{refused}");
        let other = refusal("http://lab", 404, b"<html>").to_string();
        assert!(other.contains("not as FLIP does"), "{other}");
    }
}
