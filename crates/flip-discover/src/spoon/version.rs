//! From the causes found to an extended simulator: constants of the powders that show them.

use super::ask::Calibrated;
use crate::extend::extension::{AtReference, Extended, Extension, Form, Hook, OnPowder};
use crate::report::ParameterReport;
use crate::report::spoon::{PowderReport, SpoonExtension, SpoonReport};

/// The extended simulator; `None` where no cause of a powder was found. Causes of the bench
/// (strokes, filling, the spoon's friction) are corrected in its settings, not in the simulator.
pub fn extended(report: &SpoonReport, calibrated: &[Calibrated]) -> Option<Extended> {
    let found = report.powders.iter().filter_map(|it| Some((it, it.extension.as_ref()?)));
    let found: Vec<(&PowderReport, &SpoonExtension)> =
        found.filter(|(_, extension)| extension.is_of_powder).collect();
    let extensions: Vec<Extension> =
        found.iter().flat_map(|(powder, extension)| constants(&powder.powder, extension)).collect();
    let angle = |powder: &str| calibrated.iter().find(|it| it.powder == powder)?.angle;
    let at = |powder: &str| Some(AtReference { powder: powder.to_owned(), repose: angle(powder)? });
    let powders = found.iter().filter_map(|(powder, _)| at(&powder.powder)).collect();
    (!extensions.is_empty()).then_some(Extended { extensions, powders })
}

/// Each number that the cause changes, as an extension of one powder.
fn constants(powder: &str, of: &SpoonExtension) -> Vec<Extension> {
    let amplitudes = of.change.patch.amplitudes.iter();
    let amplitudes = amplitudes.map(|(name, value)| (Hook::Extension(name.clone()), name, *value));
    let parameters = of.change.patch.parameters.iter();
    let parameters = parameters.map(|(name, value)| (Hook::Parameter(name.clone()), name, *value));
    let constant = |(hook, name, value): (Hook, &String, f64)| Extension {
        mechanism: of.cause.name().0.to_owned(),
        hook,
        form: Form::Constant,
        through: Vec::new(),
        strength: [0.0, 1.0],
        effect_deg: 0.0,
        effect_ci95: [0.0; 2],
        amplitude: ParameterReport {
            name: name.clone(),
            value,
            ci95: [value; 2],
            unit: String::new(),
        },
        powders: vec![OnPowder { powder: powder.to_owned(), effect_deg: 0.0, factor: 1.0 }],
        fit: None,
    };
    amplitudes.chain(parameters).map(constant).collect()
}
