use super::*;

#[test]
fn what_version_1_stored_reads_and_keeps_its_address() {
    let stored = include_str!("version_1.jsonl");
    let mut kinds = std::collections::HashSet::new();
    for text in stored.lines() {
        let spec = JobSpec::read(text).unwrap();
        assert_eq!(spec.canonical().0, text);
        kinds.insert(spec.kind());
    }
    assert_eq!(kinds.len(), 5, "of each kind");
}

#[test]
fn a_specification_with_a_field_of_version_2_says_so_and_one_without_keeps_its_text() {
    for text in include_str!("version_1.jsonl").lines() {
        let mut spec = JobSpec::read(text).unwrap();
        let field = match &mut spec {
            JobSpec::Evaluation(spec) => {
                spec.conditions = spec.conditions.with_substep(40).unwrap();
                "\"substep_us\":40"
            }
            JobSpec::Calibration(spec) => {
                spec.settings.fixed.insert("gravity_scale".to_owned(), 1.0);
                "\"fixed\":{\"gravity_scale\":1.0}"
            }
            JobSpec::Investigation(spec) => {
                spec.shakes = Some(SpoonSpec {
                    spoonfuls: Vec::new(),
                    calibrated: Vec::new(),
                    settings: SpoonSettings::default(),
                    spoon: Spoon::default(),
                });
                "\"shakes\":{"
            }
            _ => continue,
        };
        let (newer, sha256) = spec.canonical();
        assert!(newer.starts_with("{\"version\":2,") && newer.contains(field), "{newer}");
        assert_eq!(JobSpec::read(&newer).unwrap(), spec);
        assert_ne!(sha256, Sha256::digest(text).to_vec(), "another job");
    }
}

#[test]
fn a_card_is_an_input_of_version_6_or_8_and_the_processor_is_not_mentioned() {
    let mut met = std::collections::HashSet::new();
    for text in include_str!("version_1.jsonl").lines() {
        let mut spec = JobSpec::read(text).unwrap();
        match &mut spec {
            JobSpec::Evaluation(spec) => spec.device = Device::Cuda,
            JobSpec::Training(spec) => spec.device = Device::Cuda,
            JobSpec::Calibration(spec) => spec.device = Device::Cuda,
            _ => continue,
        }
        let version = if spec.kind() == JobKind::Calibration { 8 } else { 6 };
        met.insert(spec.kind());
        let (on_card, sha256) = spec.canonical();
        assert!(on_card.starts_with(&format!("{{\"version\":{version},")), "{on_card}");
        assert!(on_card.contains("\"device\":\"cuda\""), "{on_card}");
        assert_eq!(JobSpec::read(&on_card).unwrap(), spec);
        assert_ne!(sha256, Sha256::digest(text).to_vec(), "another job");
        assert_eq!((spec.device(), spec.subject().device), (Device::Cuda, Device::Cuda));
        assert_eq!(spec.on_cpu(None).device(), Device::Cpu);
    }
    assert_eq!(met.len(), 3, "of each kind that may be for a card");
}

#[test]
fn on_a_card_a_calibration_pours_its_heaps_together_which_is_version_9_and_back_it_is_as_before() {
    let stored = include_str!("version_1.jsonl").lines().map(|text| JobSpec::read(text).unwrap());
    let mut met = 0;
    for spec in stored {
        let JobSpec::Calibration(cpu) = &spec else { continue };
        let card = cpu.clone().on(Device::Cuda);
        assert_eq!((card.device, card.settings.tried_first), (Device::Cuda, 0));
        assert_eq!(card.simulator, simulator_on(Device::Cuda));
        assert_eq!(card.design.is_some(), cpu.design.is_some());
        assert!(card.design.as_ref().is_none_or(|design| design.initial == design.runs));
        let (text, _) = JobSpec::Calibration(card.clone()).canonical();
        assert!(text.starts_with("{\"version\":9,"), "{text}");
        assert_eq!(JobSpec::read(&text).unwrap(), JobSpec::Calibration(card.clone()));
        let back = JobSpec::Calibration(card).on_cpu(None);
        let now = CalibrationSpec { simulator: simulator_on(Device::Cpu), ..cpu.clone() };
        assert_eq!(back, JobSpec::Calibration(now));
        met += 1;
    }
    assert!(met > 0, "a calibration is among them");
}

#[test]
fn gradients_of_our_own_are_an_input_of_version_7_and_libtorch_is_not_mentioned() {
    let is_training = |spec: &JobSpec| matches!(spec, JobSpec::Training(_));
    let stored = include_str!("version_1.jsonl").lines();
    let text = stored.into_iter().find(|text| is_training(&JobSpec::read(text).unwrap()));
    let JobSpec::Training(mut training) = JobSpec::read(text.unwrap()).unwrap() else {
        panic!("not a training");
    };
    assert_eq!(training.settings.gradients, Gradients::Libtorch);
    for device in [Device::Cpu, Device::Cuda] {
        training.device = device;
        training.settings.gradients = Gradients::Fused;
        let spec = JobSpec::Training(training.clone());
        let (ours, sha256) = spec.canonical();
        assert!(ours.starts_with("{\"version\":7,"), "{ours}");
        assert!(ours.contains("\"gradients\":\"fused\""), "{ours}");
        assert_eq!(JobSpec::read(&ours).unwrap(), spec);
        training.settings.gradients = Gradients::Libtorch;
        let (other, other_sha256) = JobSpec::Training(training.clone()).canonical();
        assert!(!other.contains("gradients") && sha256 != other_sha256, "{other}");
    }
}

#[test]
fn a_newer_version_is_refused_by_its_number_and_damage_by_its_place() {
    let text = include_str!("version_1.jsonl").lines().next().unwrap();
    let newest = VERSION + 1;
    let newer = text.replacen('{', &format!("{{\"version\":{newest},"), 1);
    assert!(matches!(JobSpec::read(&newer), Err(Unreadable::Newer(version)) if version == newest));
    let damaged = text.replace("\"target\"", "\"targeted\"");
    let error = JobSpec::read(&damaged).unwrap_err();
    assert!(error.to_string().contains("missing field `target`"), "{error}");
}
