//! Campaigns of too few days.

use super::*;

/// Runs of two powders, `runs` of each on each of these sessions, with no covariate recorded.
fn unrecorded(sessions: usize, runs: usize) -> Campaign {
    let mut lab = Laboratory::new(9);
    let mut all = Vec::new();
    for k in 0..sessions * 2 * runs {
        let (session, powder) = (k / (2 * runs), k % 2);
        all.push(Run {
            row: k as u32 + 2,
            powder,
            session,
            value: Some(30.0 + 4.0 * powder as f64 + lab.normal()),
        });
    }
    Campaign { powders: vec!["sand".into(), "salt".into()], runs: all, ..Campaign::default() }
        .checked()
        .unwrap()
}

fn is_whole(report: &Report) -> bool {
    let document = serde_json::to_string(report).unwrap();
    serde_json::from_str::<Report>(&document).is_ok_and(|read| read == *report)
}

#[test]
fn a_campaign_of_one_to_five_sessions_says_that_it_cannot_be_judged_and_reads_back() {
    let never = |_: &flip_core::domain::job::Progress| std::ops::ControlFlow::Continue(());
    for sessions in 1..=5 {
        let report =
            investigate(Measured::angles(&unrecorded(sessions, 7)), "base", &SETTINGS, never)
                .unwrap()
                .unwrap();
        assert!(is_whole(&report), "{sessions} sessions");
        assert_eq!(
            (report.verdict, report.null_check.statistic, report.p_value),
            (report::Verdict::NoDiscrepancy, None, 1.0)
        );
        let why = report.unjudged.as_deref().unwrap();
        assert!(why.contains(&format!("{sessions} of the 6 sessions")), "{why}");
        assert!(
            report.sentence.starts_with("These angles cannot be judged: ")
                && why.contains("It takes"),
            "{}",
            report.sentence
        );
    }
    let enough = investigate(Measured::angles(&unrecorded(6, 4)), "base", &SETTINGS, never)
        .unwrap()
        .unwrap();
    assert!(enough.unjudged.is_none() && enough.null_check.is_judged() && is_whole(&enough));
}

#[test]
fn powders_that_were_each_measured_on_one_day_cannot_be_judged_and_say_so() {
    let mut campaign = unrecorded(7, 5);
    campaign.powders = (0..7).map(|k| format!("powder_{k}")).collect();
    campaign.runs.iter_mut().for_each(|run| run.powder = run.session);
    // One humidity per powder: no difference between the runs of a powder.
    let values =
        Values::Numbers(campaign.runs.iter().map(|run| Some(30.0 + run.session as f64)).collect());
    campaign.covariates = vec![Covariate { name: "relative_humidity_pct".to_owned(), values }];
    campaign.flow_time_s = campaign.runs.iter().map(|run| run.value).collect();
    let never = |_: &flip_core::domain::job::Progress| std::ops::ControlFlow::Continue(());
    let report =
        investigate(Measured::angles(&campaign), "base", &SETTINGS, never).unwrap().unwrap();
    assert!(report.unjudged.is_some() && is_whole(&report), "{}", report.sentence);
    assert!(report.beside.iter().all(|it| it.null_check.is_judged()), "{:?}", report.beside);
    assert!(
        report.blind_spots.iter().any(|it| it.starts_with("Flow times: nothing")),
        "{:?}",
        report.blind_spots
    );
}
