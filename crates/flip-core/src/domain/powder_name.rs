//! From a powder's name, as people write it, to its id.

use super::FieldError;
use super::powder::powder_id;
use sha2::{Digest, Sha256};

/// Maximum length of a name.
pub const NAME_CHARS_MAX: usize = 100;
/// Maximum length of an id.
const ID_CHARS_MAX: usize = 64;

/// Letters outside a to z, with their transliterations.
const LETTERS: [(&str, &str); 49] = [
    ("ä", "ae"),
    ("ö", "oe"),
    ("ü", "ue"),
    ("ß", "ss"),
    ("æ", "ae"),
    ("œ", "oe"),
    ("øõóòôőō", "o"),
    ("åáàâãāăą", "a"),
    ("çćč", "c"),
    ("ďđð", "d"),
    ("éèêëēėęě", "e"),
    ("ğ", "g"),
    ("íìîïīı", "i"),
    ("ł", "l"),
    ("ñńň", "n"),
    ("řŕ", "r"),
    ("śšş", "s"),
    ("ťţ", "t"),
    ("þ", "th"),
    ("úùûūůű", "u"),
    ("ýÿ", "y"),
    ("źżž", "z"),
    ("α", "alpha"),
    ("β", "beta"),
    ("γ", "gamma"),
    ("δ", "delta"),
    ("ε", "epsilon"),
    ("κ", "kappa"),
    ("λ", "lambda"),
    ("µμ", "micro"),
    ("π", "pi"),
    ("ρ", "rho"),
    ("σ", "sigma"),
    ("ω", "omega"),
    ("θ", "theta"),
    ("χ", "chi"),
    ("ψ", "psi"),
    ("τ", "tau"),
    ("η", "eta"),
    ("₀⁰", "0"),
    ("₁¹", "1"),
    ("₂²", "2"),
    ("₃³", "3"),
    ("₄⁴", "4"),
    ("₅⁵", "5"),
    ("₆⁶", "6"),
    ("₇⁷", "7"),
    ("₈⁸", "8"),
    ("₉⁹", "9"),
];

/// Returns the id of the powder named by a text: the text itself if it is an id, otherwise an id
/// derived from it. `Lactose 200M` becomes `lactose_200m`, `3-Nitrotoluene` becomes
/// `p_3_nitrotoluene`; letters without a counterpart in a to z are replaced by eight digits of the
/// name's SHA-256.
///
/// # Errors
/// A text without a letter or digit, longer than 100 characters, or with control characters;
/// `field` is the name of the field it came from.
pub fn id_of_powder(field: &str, text: &str) -> Result<String, FieldError> {
    if let Ok(id) = powder_id(field, text) {
        return Ok(id);
    }
    let is_name = text.chars().count() <= NAME_CHARS_MAX && !text.chars().any(char::is_control);
    if !is_name || !text.chars().any(char::is_alphanumeric) {
        let advice = format!(
            "must be a powder's id or its name: 1 to {NAME_CHARS_MAX} characters, with a letter or digit among them"
        );
        return Err(FieldError::new(field, advice));
    }
    Ok(made_of(&same_name(text)))
}

/// The id, or the first of `id_2`, `id_3`, ... that is not taken.
pub fn with_suffix(id: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let numbered = |k: u32| {
        let suffix = format!("_{k}");
        let kept = &id[..id.len().min(ID_CHARS_MAX - suffix.len())];
        format!("{}{suffix}", kept.trim_end_matches('_'))
    };
    if !is_taken(id) {
        return id.to_owned();
    }
    (2..).map(numbered).find(|id| !is_taken(id)).unwrap_or_else(|| id.to_owned())
}

/// Normalises a name for comparison: case and runs of blanks do not matter.
pub fn same_name(name: &str) -> String {
    name.split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase()
}

fn made_of(name: &str) -> String {
    let (mut id, mut is_whole) = (String::new(), true);
    for letter in name.chars() {
        match plain(letter) {
            Some(plain) => id.push_str(&plain),
            None => {
                is_whole &= !letter.is_alphanumeric();
                id.push('_');
            }
        }
    }
    let parts: Vec<&str> = id.split('_').filter(|part| !part.is_empty()).collect();
    let mut id = parts.join("_");
    if !id.starts_with(|c: char| c.is_ascii_lowercase()) {
        id = format!("p_{id}");
    }
    if is_whole && id.len() <= ID_CHARS_MAX {
        return id;
    }
    let hash = hex::encode(&Sha256::digest(name.as_bytes())[..4]);
    id.truncate(ID_CHARS_MAX - 9);
    format!("{}_{hash}", id.trim_end_matches('_'))
}

/// Letters and digits in the form allowed in an id.
fn plain(letter: char) -> Option<String> {
    let known = || LETTERS.iter().find(|(letters, _)| letters.contains(letter));
    match letter {
        'a'..='z' | '0'..='9' => Some(letter.to_string()),
        _ => known().map(|(_, plain)| (*plain).to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_makes_an_id_and_an_id_stays_itself() {
        let of = |name: &str| id_of_powder("powder", name).unwrap();
        for (name, id) in [
            ("salt", "salt"),
            ("Salt", "salt"),
            ("Sodium bicarbonate", "sodium_bicarbonate"),
            ("Lactose 200M", "lactose_200m"),
            ("  Lactose   200M ", "lactose_200m"),
            ("3-Nitrotoluene", "p_3_nitrotoluene"),
            ("Stärke (Mais)", "staerke_mais"),
            ("α-Lactose", "alpha_lactose"),
            ("TiO₂ P25", "tio2_p25"),
            ("100", "p_100"),
        ] {
            assert_eq!(of(name), id, "{name}");
            assert_eq!(of(&of(name)), id, "the id of {name}");
        }
        let long = of(&"Starch ".repeat(13));
        assert!(long.len() <= 64 && powder_id("id", &long).is_ok(), "{long}");
        for name in ["", "!?", "a\nb", &"x ".repeat(51)] {
            assert_eq!(
                id_of_powder("row[2].powder", name).unwrap_err().field,
                "row[2].powder",
                "{name:?}"
            );
        }
    }

    #[test]
    fn a_taken_id_gets_the_next_number_and_keeps_its_length() {
        let taken = ["salt", "salt_2"];
        assert_eq!(with_suffix("sugar", |id| taken.contains(&id)), "sugar");
        assert_eq!(with_suffix("salt", |id| taken.contains(&id)), "salt_3");
        let long = "a".repeat(64);
        let made = with_suffix(&long, |id| id == long);
        assert_eq!((made.len(), made.ends_with("a_2")), (64, true));
        assert!(powder_id("id", &made).is_ok());
    }

    #[test]
    fn names_of_other_alphabets_have_ids_that_differ() {
        let of = |name: &str| id_of_powder("powder", name).unwrap();
        let [salt, sugar, named] = [of("食盐"), of("白糖"), of("食盐 A")];
        assert!(
            salt != sugar && salt.starts_with("p_") && named.starts_with("a_"),
            "{salt} {sugar} {named}"
        );
        assert!([&salt, &sugar, &named].iter().all(|id| powder_id("id", id).is_ok()));
        assert_eq!(salt, of("食盐"), "the same every time");
    }
}
