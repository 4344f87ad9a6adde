//! `flip token`: creates, lists and revokes API tokens, even while a server runs; also the token
//! printed by a first start.

use super::failure::Failure;
use super::session::{beside, with_reader};
use super::table::table;
use super::{Common, FIRST_PAGE};
use crate::app::{App, NewToken, Role, TokenEntry};
use clap::{Subcommand, ValueEnum};
use flip_core::domain::FieldError;
use serde::Serialize;

/// Arguments of `flip token`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Create an API token and print it; it is shown only once and stored only as a hash.
    Create {
        /// What the holder may do: read; also start and stop work; everything.
        #[arg(long, value_enum)]
        role: RoleFlag,
        /// Name of the token, as it appears in records.
        #[arg(long, default_value = "command line")]
        name: String,
        /// Let the holder clear a latched bench; an admin always may.
        #[arg(long)]
        may_clear: bool,
        /// Lifetime: a whole number with s, m, h or d, as in 12h; if omitted, until revoked.
        #[arg(long, value_name = "TIME")]
        expires_in: Option<String>,
    },
    /// List tokens, newest first, including ended ones; secrets are never shown.
    List,
    /// Revoke a token with immediate effect.
    Revoke {
        /// Token id, as listed: the first part of the secret.
        id: String,
    },
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RoleFlag {
    Viewer,
    Operator,
    Admin,
}

/// The document of `flip token create`.
#[derive(Debug, Serialize)]
struct Document {
    token: String,
    #[serde(flatten)]
    entry: TokenEntry,
}

/// The document of `flip token list`.
#[derive(Debug, Serialize)]
struct List {
    items: Vec<TokenEntry>,
}

/// Runs the chosen subcommand.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.action {
        Action::Create { role, name, may_clear, expires_in } => {
            let expires_in_s = expires_in.as_deref().map(seconds).transpose()?;
            create(
                common,
                &NewToken {
                    name: name.clone(),
                    role: Role::from(*role),
                    may_clear: *may_clear,
                    expires_in_s,
                },
            )
        }
        Action::List => list(common),
        Action::Revoke { id } => {
            let entry = beside(common, async |lab| Ok(lab.revoke_token(id).await?))?;
            common.print(&entry, || format!("token {} ({}) has ended", entry.id, entry.name))
        }
    }
}

fn create(common: &Common, new: &NewToken) -> Result<(), Failure> {
    let (entry, token) = beside(common, async |lab| Ok(lab.make_token(new).await?))?;
    let document = Document { token, entry };
    common.print(&document, || document.token.clone())
}

fn list(common: &Common) -> Result<(), Failure> {
    let items = with_reader(common, async |lab| {
        let (mut items, mut page) = (Vec::new(), FIRST_PAGE);
        loop {
            let found = lab.tokens(page).await?;
            items.extend(found.items);
            match found.next {
                Some(next) => page = crate::app::PageQuery { after: Some(next), ..FIRST_PAGE },
                None => return Ok(items),
            }
        }
    })?;
    let list = List { items };
    common.print(&list, || text(&list.items))
}

fn text(items: &[TokenEntry]) -> String {
    let word = |time: Option<crate::app::Timestamp>, none: &str| {
        time.map_or(none.to_owned(), |time| time.to_string())
    };
    let rows = items.iter().map(|it| {
        let ends = match it.revoked_at {
            Some(at) => format!("revoked {at}"),
            None => word(it.expires_at, "never"),
        };
        let role = format!("{:?}{}", it.role, if it.may_clear { ", may clear" } else { "" })
            .to_lowercase();
        vec![
            it.id.clone(),
            it.name.clone(),
            role,
            it.created_at.to_string(),
            word(it.last_used_at, "never"),
            ends,
            it.issuer.clone().unwrap_or_else(|| "FLIP".to_owned()),
        ]
    });
    table(&["id", "name", "role", "made", "last used", "ends", "from"], &rows.collect::<Vec<_>>())
}

/// Seconds in `90s`, `15m`, `12h` or `30d`.
fn seconds(text: &str) -> Result<u64, FieldError> {
    let wrong = || {
        FieldError::new(
            "expires-in",
            format!("must be a whole number and s, m, h or d, as in 12h, got `{text}`"),
        )
    };
    let unit = match text.chars().last() {
        Some('s') => 1,
        Some('m') => 60,
        Some('h') => 3600,
        Some('d') => 86_400,
        _ => return Err(wrong()),
    };
    let number: u64 = text[..text.len() - 1].parse().map_err(|_| wrong())?;
    number.checked_mul(unit).ok_or_else(wrong)
}

/// An admin's token if this data folder has none yet: the person who starts the service first
/// creates the others.
pub(super) async fn first(app: &App) -> Result<Option<String>, Failure> {
    if app.has_tokens().await? {
        return Ok(None);
    }
    Ok(Some(app.create_token("first start", Role::Admin).await?))
}

impl From<RoleFlag> for Role {
    fn from(flag: RoleFlag) -> Self {
        match flag {
            RoleFlag::Viewer => Self::Viewer,
            RoleFlag::Operator => Self::Operator,
            RoleFlag::Admin => Self::Admin,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_life_is_a_number_with_its_unit() {
        for (text, found) in [("90s", 90), ("15m", 900), ("12h", 43_200), ("30d", 2_592_000)] {
            assert_eq!(seconds(text), Ok(found));
        }
        for wrong in ["", "12", "h", "1.5h", "-1d", "1 d", "99999999999999999d", "1é"] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
    }
}
