//! One table in any form that a laboratory may write it in is one campaign.

use super::*;
use proptest::prelude::*;

/// Powder, angle in hundredths of a degree, month and day, humidity in tenths of a percent, operator.
type Row = (usize, i32, (u8, u8), Option<i32>, usize);

/// A format in which a laboratory may write a table.
#[derive(Debug, Clone)]
struct Form {
    separator: char,
    comma: bool,
    date: usize,
    header: usize,
    missing: usize,
    wrapping: usize,
    order: Vec<usize>,
}

impl Form {
    fn plain() -> Self {
        Self {
            separator: ',',
            comma: false,
            date: 0,
            header: 0,
            missing: 0,
            wrapping: 0,
            order: (0..5).collect(),
        }
    }

    fn number(&self, number: String) -> String {
        match (self.comma, self.separator) {
            (true, ',') => format!("\"{}\"", number.replace('.', ",")),
            (true, _) => number.replace('.', ","),
            (false, _) => number,
        }
    }

    fn date(&self, month: u8, day: u8) -> String {
        let short =
            ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
                [month as usize - 1];
        match self.date {
            0 => format!("2026-{month:02}-{day:02}"),
            1 => format!("{day}.{month}.2026"),
            2 => format!("{month}/{day}/2026"),
            3 => format!("{day:02}-{short}-26"),
            4 => format!("{day} {short} 2026 09:30"),
            _ => format!("2026-{month:02}-{day:02}T14:00:00Z"),
        }
    }

    fn name(&self, name: &str) -> String {
        match self.header {
            0 => name.to_owned(),
            1 => name.to_uppercase(),
            _ => format!(" {} ", name.replace('_', " ")),
        }
    }

    /// Writes these rows as a table: powder, angle, day, humidity, operator.
    fn write(&self, rows: &[Row]) -> String {
        let missing = ["", "NA", "n.d.", "-", "#N/A"][self.missing];
        let header = ["powder", "repose_deg", "session", "relative_humidity_pct", "operator"]
            .map(|name| self.name(name));
        let cells = rows.iter().map(|(powder, angle, (month, day), humidity, operator)| {
            let humidity = humidity.map(|it| self.number(format!("{:.1}", f64::from(it) / 10.0)));
            [
                ["salt", "sugar", "flour"][*powder].to_owned(),
                self.number(format!("{:.2}", f64::from(*angle) / 100.0)),
                self.date(*month, *day),
                humidity.unwrap_or_else(|| missing.to_owned()),
                ["Ada", "Ben", "Chloe"][*operator].to_owned(),
            ]
        });
        let line = |cells: [String; 5]| {
            let cells: Vec<&str> = self.order.iter().map(|&k| cells[k].as_str()).collect();
            let end = if self.wrapping == 1 {
                self.separator.to_string().repeat(2)
            } else {
                String::new()
            };
            cells.join(&self.separator.to_string()) + &end
        };
        let lines: Vec<String> = std::iter::once(header).chain(cells).map(line).collect();
        match self.wrapping {
            2 => format!("\u{feff}sep={}\r\n{}\r\n\u{1a}", self.separator, lines.join("\r\n")),
            3 => format!("\u{feff}{}\r\n\r\n", lines.join("\r\n")),
            4 => lines.join("\r"),
            _ => lines.join("\n") + "\n",
        }
    }
}

fn forms() -> impl Strategy<Value = Form> {
    let order = Just((0..5).collect::<Vec<usize>>()).prop_shuffle();
    (
        prop::sample::select(vec![',', ';', '\t', '|']),
        any::<bool>(),
        0..6_usize,
        0..3_usize,
        0..5_usize,
        0..5_usize,
        order,
    )
        .prop_map(|(separator, comma, date, header, missing, wrapping, order)| Form {
            separator,
            comma,
            date,
            header,
            missing,
            wrapping,
            order,
        })
}

proptest! {
    #[test]
    fn one_table_in_any_form_is_one_campaign(
        rows in prop::collection::vec((0..3_usize, 2500..4500_i32, (1..=12_u8, 1..=28_u8), prop::option::of(300..700_i32), 0..3_usize), 1..30),
        form in forms(),
    ) {
        let of = |form: &Form| {
            let text = form.write(&rows);
            let mut read = read(&text, &REQUIRED, Some(DateOrder::MonthFirst)).map_err(|error| format!("{error}: {text}"))?;
            read.campaign.covariates.sort_by(|a, b| a.name.cmp(&b.name));
            read.read.columns.sort_by(|a, b| a.column.cmp(&b.column));
            Ok::<_, String>(read)
        };
        prop_assert_eq!(of(&form), of(&Form::plain()));
    }
}
