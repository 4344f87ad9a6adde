use super::*;

#[test]
fn the_papers_preset_is_the_published_one() {
    let paper = Settings::of(Preset::Paper, Order::Curriculum, 1).checked().unwrap();
    assert_eq!(paper.rules, Rules::PAPER);
    assert_eq!(
        (paper.episodes, paper.batch, paper.learning_rate, paper.gamma, paper.tau),
        (4000, 16, 1e-4, 0.99, 0.005)
    );
    assert_eq!(
        (paper.updates_per_step, paper.relabel_share, paper.overdose_factor),
        (1.0, 0.0, 1.0)
    );
    assert_eq!(
        (paper.network, paper.critic_loss),
        (Network::Recurrent { replayed: Replayed::StoredState }, CriticLoss::Huber)
    );
    assert_eq!(paper.level_episodes_max(4000, 3), 1330);
}

#[test]
fn the_share_that_is_done_counts_what_episodes_take() {
    let settings = Settings {
        episodes: 1100,
        surrogate_episodes: 1000,
        ..Settings::of(Preset::Flip, Order::Random, 1)
    };
    let shares = [0, 500, 1000, 1050, 1100].map(|episodes| settings.share_done(episodes));
    assert_eq!(shares, [0.0, 10.0 / 120.0, 20.0 / 120.0, 70.0 / 120.0, 1.0]);
    let all = Settings { surrogate_episodes: 1100, ..settings };
    assert_eq!([0, 550, 1100].map(|episodes| all.share_done(episodes)), [0.0, 0.5, 1.0]);
}

#[test]
fn a_demonstration_shares_its_episodes_among_the_levels() {
    let settings = Settings::of(Preset::Flip, Order::Curriculum, 1);
    assert_eq!(settings.box_share, 0.25);
    assert_eq!(settings.level_episodes_max(160, 3), 40);
    assert_eq!(Settings { box_share: 0.0, ..settings }.level_episodes_max(160, 3), 54);
}

#[test]
fn hindsight_is_refused_where_states_are_stored_and_settings_from_before_networks_are_read() {
    let paper = Settings { relabel_share: 0.5, ..Settings::of(Preset::Paper, Order::Random, 1) };
    assert_eq!(paper.clone().checked().unwrap_err().field, "relabel_share");
    let network = Network::Recurrent { replayed: Replayed::Episodes };
    assert!(Settings { network, ..paper }.checked().is_ok());
    let flip = Settings::of(Preset::Flip, Order::Random, 1);
    let mut document = serde_json::to_value(&flip).unwrap();
    document.as_object_mut().unwrap().retain(|key, _| key != "network" && key != "critic_loss");
    assert_eq!(serde_json::from_value::<Settings>(document).unwrap(), flip);
}

#[test]
fn settings_survive_json_and_bad_ones_are_refused_by_name() {
    let settings = Settings::of(Preset::Flip, Order::DomainRandomisation, 9);
    let text = serde_json::to_string(&settings).unwrap();
    assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
    let refused = |change: fn(&mut Settings)| {
        let mut settings = Settings::of(Preset::Flip, Order::Random, 9);
        change(&mut settings);
        settings.checked().unwrap_err().field
    };
    assert_eq!(refused(|s| s.gamma = f64::NAN), "gamma");
    assert_eq!(refused(|s| s.batch = 0), "batch");
    assert_eq!(refused(|s| s.surrogate_episodes = s.episodes + 1), "surrogate_episodes");
    assert_eq!(refused(|s| s.target_mg_max = 1.0), "target_mg_max");
}
