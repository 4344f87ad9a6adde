//! The tables of a certificate, row by row.

use super::words::{digits, outcome, yes};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::MeasuredMass;
use flip_store::weighings::Weighing;

pub(super) fn asked(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![
        ("Powder", weighing.powder.clone()),
        ("Target", format!("{} mg", digits(weighing.target_mg))),
        (
            "Tolerance",
            format!(
                "-{} / +{} mg",
                digits(weighing.tolerance_lower_mg),
                digits(weighing.tolerance_upper_mg)
            ),
        ),
    ];
    let asked = &weighing.asked;
    let mut more = |name, value: Option<String>| rows.extend(value.map(|value| (name, value)));
    more("List", asked.list.clone());
    more("Position", asked.position.clone());
    more("Lot", asked.lot.clone());
    more("Vial", asked.vial.clone());
    more("Requested by", asked.operator.clone());
    more("Temperature", asked.temperature_c.map(|c| format!("{c} °C")));
    more("Relative humidity", asked.relative_humidity_pct.map(|pct| format!("{pct} %")));
    let checked = (!asked.checked.is_empty()).then(|| asked.checked.join("; "));
    more("Confirmed before", checked);
    more("Required accuracy", asked.accuracy_pct.map(|pct| format!("{pct} %")));
    rows
}

pub(super) fn measured(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![("Outcome", outcome(weighing))];
    let Some(it) = &weighing.measured else { return rows };
    let mg = |value: Option<f64>| {
        value.map_or_else(
            || "not reported by the balance".to_owned(),
            |mg| format!("{} mg", digits(mg)),
        )
    };
    rows.extend([
        ("Gross", mg(it.gross_mg)),
        ("Tare", mg(it.tare_mg)),
        ("Zero after the tare", mg(it.zero_mg)),
        ("Net", format!("{} mg", digits(it.net_mg))),
        ("Expanded uncertainty (k = 2)", format!("{} mg", digits(it.uncertainty_mg))),
        (
            "Minimum weight",
            it.minimum_mg.map_or_else(
                || "not known: no repeatability check".to_owned(),
                |mg| format!("{} mg", digits(mg)),
            ),
        ),
        (
            "Stable by the balance / by FLIP's window",
            format!("{} / {}", yes(it.stable_by_balance), yes(it.stable_by_window)),
        ),
    ]);
    rows.extend(
        weighing.error_mg.map(|mg| ("Error (net minus target)", format!("{} mg", digits(mg)))),
    );
    rows.extend(drift(it));
    rows.extend(weighing.shakes.map(|n| ("Shakes", n.to_string())));
    rows.extend(weighing.seconds.map(|s| ("Duration by the bench's clock", format!("{s:.1} s"))));
    let thrown = it.discarded_mg.iter().map(|mg| digits(*mg)).collect::<Vec<_>>().join(", ");
    rows.extend((!thrown.is_empty()).then_some(("Discarded before, mg", thrown)));
    rows
}

fn drift(it: &MeasuredMass) -> Option<(&'static str, String)> {
    let (before, after) = (it.drift_before_mg_min?, it.drift_after_mg_min?);
    Some(("Drift before / after", format!("{} / {} mg/min", digits(before), digits(after))))
}

pub(super) fn provenance(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![("Weighing", weighing.id.clone()), ("Policy", weighing.policy.clone())];
    let bench = |bench| match bench {
        BenchKind::Simulated => "simulated",
        BenchKind::Emulated => "emulated devices",
        BenchKind::Devices => "real devices",
    };
    rows.extend(weighing.bench.map(|it| ("Bench", bench(it).to_owned())));
    rows.push((
        "Simulator",
        weighing.under.as_ref().map_or_else(|| "base".to_owned(), |under| under.simulator.clone()),
    ));
    if let Some(measured) = &weighing.measured {
        let named = |(role, name): (&String, &String)| format!("{role}: {name}");
        rows.push(("Devices", measured.devices.iter().map(named).collect::<Vec<_>>().join("; ")));
    }
    rows.push(("Request recorded", weighing.created_at.to_string()));
    rows.extend(weighing.started_at.map(|at| ("Armed", at.to_string())));
    rows.extend(weighing.finished_at.map(|at| ("Ended", at.to_string())));
    rows
}
