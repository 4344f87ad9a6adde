//! A weighing in the Allotrope Simple Model (ASM), for laboratories that keep their data in it.
//!
//! Structure and names are those of the manifest `balance`, REC/2025/03, as the LADS server of
//! AixEngineers writes them (`lads-asm-balance.ts`); the custom documents are those of ASM's core.
//! The schemas themselves are for members of the Allotrope Foundation, so a document is not checked
//! against them.

use super::{App, Result, WeighingDetail};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::MeasuredMass;
use serde_json::{Map, Value, json};

const MANIFEST: &str = "http://purl.allotrope.org/manifests/balance/REC/2025/03/balance.manifest";

impl App {
    /// The ASM document of a dose that has ended.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`weighing_unfinished`, `not_a_dose`, `record_differs`); `Lost` if the
    /// readings are.
    pub async fn asm(&self, id: &str) -> Result<Value> {
        let (detail, _) = self.ended_dose(id).await?;
        if let Some(why) = detail.trace_lost {
            return Err(super::Error::Lost(why));
        }
        Ok(document(&detail))
    }
}

fn document(detail: &WeighingDetail) -> Value {
    let weighing = &detail.weighing;
    let devices = weighing.measured.as_ref().map(|it| &it.devices);
    let devices = devices.into_iter().flatten().enumerate().map(|(k, (role, name))| {
        json!({ "@index": k + 1, "device type": role, "device identifier": name })
    });
    let person = weighing.asked.operator.as_ref().map(|name| ("analyst", json!(name)));
    let measured = json!({
        "experiment identifier": weighing.asked.list.as_ref().unwrap_or(&weighing.id),
        "measurement document": [measurement(detail)],
    });
    let dose = [("measurement aggregate document", measured)].into_iter().chain(person);
    json!({
        "$asm.manifest": MANIFEST,
        "weighing aggregate document": {
            "device system document": {
                "asset management identifier": bench(weighing.bench),
                "device document": devices.collect::<Vec<_>>(),
            },
            "weighing document": [object(dose)],
        },
    })
}

fn measurement(detail: &WeighingDetail) -> Value {
    let weighing = &detail.weighing;
    let asked = &weighing.asked;
    let mg = |value: f64| json!({ "value": value, "unit": "mg" });
    let sample = [
        ("written name", Some(&weighing.powder)),
        ("batch identifier", asked.lot.as_ref()),
        ("sample identifier", asked.vial.as_ref()),
        ("location identifier", asked.position.as_ref()),
    ];
    let sample = sample.into_iter().filter_map(|(name, text)| Some((name, json!(text?))));
    let measured = weighing.measured.as_ref();
    let net = measured.map(|it| it.net_mg).or(weighing.reading_mg);
    let masses = [
        ("sample weight", net),
        ("gross weight", measured.and_then(|it| it.gross_mg)),
        ("tare weight", measured.and_then(|it| it.tare_mg)),
    ];
    let masses = masses.into_iter().filter_map(|(name, value)| Some((name, mg(value?))));
    let more = [
        ("measurement identifier", json!(weighing.id)),
        ("measurement time", json!(weighing.finished_at)),
        ("sample document", object(sample)),
        ("data cube", readings(detail)),
        ("custom information aggregate document", custom(detail, measured)),
    ];
    object(masses.chain(more))
}

/// The readings over the time since the bench began.
fn readings(detail: &WeighingDetail) -> Value {
    let concept =
        |concept, unit| json!({ "@componentDatatype": "double", "concept": concept, "unit": unit });
    let (times, masses): (Vec<_>, Vec<_>) =
        detail.ticks.iter().map(|tick| (tick.t_s, tick.reading.mass_mg)).unzip();
    json!({
        "label": detail.weighing.id,
        "cube-structure": {
            "dimensions": [concept("elapsed time", "s")],
            "measures": [concept("sample weight", "mg")],
        },
        "data": { "dimensions": [times], "measures": [masses] },
    })
}

/// What a dose has and a balance has not.
fn custom(detail: &WeighingDetail, measured: Option<&MeasuredMass>) -> Value {
    let weighing = &detail.weighing;
    let number = |label, value: Option<f64>| {
        value.map(|value| json!({ "datum label": label, "scalar double datum": { "value": value, "unit": "mg" } }))
    };
    let text =
        |label, value: Value| Some(json!({ "datum label": label, "scalar string datum": value }));
    let data = [
        text("outcome", json!(weighing.outcome)),
        number("target mass", Some(weighing.target_mg)),
        number("accepted shortfall", Some(weighing.tolerance_lower_mg)),
        number("accepted excess", Some(weighing.tolerance_upper_mg)),
        number("error", weighing.error_mg),
        number("expanded uncertainty (k = 2)", measured.map(|it| it.uncertainty_mg)),
        text("policy", json!(weighing.policy)),
    ];
    json!({ "custom information document": data.into_iter().flatten().collect::<Vec<_>>() })
}

fn bench(kind: Option<BenchKind>) -> &'static str {
    match kind {
        Some(BenchKind::Devices) => "FLIP bench",
        Some(BenchKind::Emulated) => "FLIP bench, emulated: no real powder was weighed",
        Some(BenchKind::Simulated) => "FLIP bench, simulated: no real powder was weighed",
        None => "none: it ended before a bench was armed",
    }
}

fn object<'a>(fields: impl Iterator<Item = (&'a str, Value)>) -> Value {
    Value::Object(fields.map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>())
}
