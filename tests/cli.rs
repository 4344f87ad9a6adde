//! The command line as scripts see it: the real binary, its exit status, its single document.

use flip_policy::{
    self as policy, Controller, Done, Gains, Kind, Manifest, Observation, Pid, Policy, Rules,
};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

const COMMANDS: [&str; 22] = [
    "serve",
    "demo",
    "repose",
    "validate",
    "bench",
    "calibrate",
    "compare",
    "observe",
    "measurements",
    "train",
    "evaluate",
    "discover",
    "policy",
    "weigh",
    "jobs",
    "token",
    "backup",
    "restore",
    "doctor",
    "config",
    "completions",
    "man",
];

fn flip(data_dir: &Path, arguments: &[&str]) -> Output {
    command(data_dir, arguments).output().unwrap()
}

fn command(data_dir: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flip"));
    command.args(arguments).arg("--data-dir").arg(data_dir).env_remove("FLIP_LOG");
    command
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// The single document on stdout; anything in addition to it does not parse.
fn document(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(&text)
        .unwrap_or_else(|e| panic!("{e}: stdout {text:?}, stderr {:?}", stderr(output)))
}

fn expect_status(output: &Output, status: i32) {
    assert_eq!(output.status.code(), Some(status), "stderr: {}", stderr(output));
}

#[test]
fn help_lists_every_command_and_every_command_has_help() {
    let folder = tempfile::tempdir().unwrap();
    let help = flip(folder.path(), &["--help"]);
    expect_status(&help, 0);
    let text = String::from_utf8(help.stdout).unwrap();
    for name in COMMANDS {
        assert!(
            text.lines().any(|line| line.trim_start().starts_with(name)),
            "{name} is missing in:\n{text}"
        );
        let help = flip(folder.path(), &[name, "--help"]);
        expect_status(&help, 0);
        let text = String::from_utf8(help.stdout).unwrap();
        for flag in ["--data-dir", "--seed", "--json"] {
            assert!(text.contains(flag), "{name} --help does not name {flag}");
        }
    }
}

#[test]
fn a_doctor_looks_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let looked = flip(&data, &["doctor", "--listen", "127.0.0.1:0", "--json"]);
    expect_status(&looked, 0);
    let found = document(&looked);
    let names: Vec<&str> =
        found.as_array().unwrap().iter().map(|it| it["what"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["processor", "memory", "clock", "descriptors", "disk", "data folder", "port"]
    );
    assert!(!data.exists());
    expect_status(&flip(&data, &["jobs"]), 0);
    std::fs::write(folder.path().join("bench.toml"), "[balance]\n").unwrap();
    let bench = folder.path().join("bench.toml");
    let looked = flip(
        &data,
        &["doctor", "--listen", "127.0.0.1:0", "--bench", bench.to_str().unwrap(), "--json"],
    );
    expect_status(&looked, 1);
    let found = document(&looked);
    let of = |what: &str| {
        found.as_array().unwrap().iter().find(|it| it["what"] == what).unwrap()["verdict"].clone()
    };
    assert_eq!((of("database"), of("bench file")), (json!("ok"), json!("failed")));
}

#[test]
fn a_settings_file_stands_behind_the_command_line_and_a_mistake_in_it_begins_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("flip.toml"));
    let file_name = file.to_str().unwrap();
    let run = |text: &str, words: &[&str]| {
        std::fs::write(&file, text).unwrap();
        Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(words)
            .env("FLIP_SETTINGS", &file)
            .output()
            .unwrap()
    };
    let settings = format!(
        "data_dir = {:?}\njson = true\n[repose]\nfriction = 0.3\ncohesion = 0\n",
        data.to_str().unwrap()
    );
    let by_file = run(&settings, &["repose"]);
    expect_status(&by_file, 0);
    let typed = flip(&data, &["repose", "--friction", "0.3", "--cohesion", "0", "--json"]);
    assert_eq!(document(&by_file), document(&typed));
    let over = run(&settings, &["repose", "--friction", "0.5"]);
    assert_ne!(document(&over)["parameters"], document(&typed)["parameters"]);
    let wrong = run("[repose]\nfricton = 0.3\n", &["repose", "--json"]);
    expect_status(&wrong, 2);
    assert!(
        document(&wrong).to_string().contains("did you mean `friction`"),
        "{}",
        document(&wrong)
    );
    let checked = run("[serve]\nlisten = \"127.0.0.1:9\"\n", &["config", "check", file_name]);
    assert_eq!(
        String::from_utf8(checked.stdout).unwrap().trim(),
        "flip serve --listen 127.0.0.1:9"
    );
    let half = run(
        "[serve]\nlisten = \"127.0.0.1:0\"\ntls_cert = \"c.pem\"\n",
        &["serve", "--data-dir", data.to_str().unwrap()],
    );
    expect_status(&half, 2);
    assert!(stderr(&half).contains("--tls-key"), "{}", stderr(&half));
    // The bench file of `flip bench check --config` is not the settings file.
    let check = run(
        "",
        &[
            "bench",
            "check",
            "--config",
            "/no/such/bench.toml",
            "--data-dir",
            data.to_str().unwrap(),
        ],
    );
    expect_status(&check, 2);
    assert!(
        stderr(&check).contains("/no/such/bench.toml") && !stderr(&check).contains("settings"),
        "{}",
        stderr(&check)
    );
}

#[test]
fn shells_and_man_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = flip(folder.path(), &["completions", shell]);
        expect_status(&script, 0);
        let script = String::from_utf8(script.stdout).unwrap();
        assert!(COMMANDS.iter().all(|name| script.contains(name)), "{shell}");
    }
    let pages = folder.path().join("man1");
    expect_status(&flip(folder.path(), &["man", pages.to_str().unwrap()]), 0);
    for name in COMMANDS {
        let page = std::fs::read_to_string(pages.join(format!("flip-{name}.1"))).unwrap();
        assert!(page.contains("\\-\\-data\\-dir") || page.contains("data"), "{name}");
    }
}

#[test]
fn repose_gives_the_same_bytes_twice_on_any_number_of_threads_and_on_every_path() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "repose",
        "--friction",
        "0.3",
        "--cohesion",
        "0",
        "--repeats",
        "3",
        "--seed",
        "1",
        "--json",
    ];
    let with = |name: &str, value: &str| {
        let output = command(folder.path(), &arguments).env(name, value).output().unwrap();
        expect_status(&output, 0);
        output.stdout
    };
    let one = with("RAYON_NUM_THREADS", "1");
    assert_eq!(one, with("RAYON_NUM_THREADS", "1"));
    assert_eq!(one, with("RAYON_NUM_THREADS", "2"));
    // A processor without AVX2 runs the portable path three times.
    assert_eq!(one, with("FLIP_SIMD", "portable"));
    assert_eq!(one, with("FLIP_SIMD", "avx2"));
    let document: Value = serde_json::from_slice(&one).unwrap();
    for key in ["repose_deg", "cone_deg", "repose_sd_deg", "particles", "creep_deg_per_s"] {
        assert!(document[key].is_number(), "{key} is not a number in {document}");
    }
    assert!(document["settings"].is_object());
    assert_eq!(document["parameters"]["friction"], 0.3);
}

#[test]
fn a_heap_says_whose_semantics_poured_it() {
    let folder = tempfile::tempdir().unwrap();
    let heap = |flags: &[&str]| {
        let arguments =
            [&["repose", "--particles", "300", "--seed", "1", "--json"], flags].concat();
        document(&flip(folder.path(), &arguments))
    };
    let (own, published) = (heap(&[]), heap(&["--compat", "physx"]));
    assert_eq!(own["settings"]["compat"], "physical");
    assert_eq!(published["settings"]["compat"], "physx");
    assert_eq!(own, heap(&["--compat", "physical"]));
    assert_ne!(own["repose_deg"], published["repose_deg"]);
}

#[test]
fn validate_prints_what_it_measured_and_knows_its_checks_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let output = flip(
        folder.path(),
        &["validate", "--only", "free_fall", "--only", "incline_threshold", "--json"],
    );
    expect_status(&output, 0);
    let document = document(&output);
    let names: Vec<&str> = document["checks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["free_fall", "incline_threshold"]);
    for check in document["checks"].as_array().unwrap() {
        assert_eq!(check["passed"], true, "{check}");
        for key in ["measured", "expected", "tolerance"] {
            assert!(check[key].is_f64(), "{key} of {check}");
        }
        assert!(check["unit"].is_string() && !check["source"].as_str().unwrap().is_empty());
    }
    let unknown = flip(folder.path(), &["validate", "--only", "antigravity"]);
    expect_status(&unknown, 2);
    assert!(
        stderr(&unknown).contains("only") && stderr(&unknown).contains("free_fall"),
        "{}",
        stderr(&unknown)
    );
}

#[test]
fn bad_input_exits_2_and_names_the_field() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[&str], &str); 33] = [
        (&["repose", "--friction", "1.31"], "friction: must be a number from 0 to 1.3"),
        (&["repose", "--cohesion", "NaN"], "cohesion: must be a number from 0 to 1.2"),
        (&["repose", "--particle-diameter-mm", "-1"], "particle_diameter_mm"),
        (&["repose", "--damping", "soft"], "--damping"),
        (&["repose", "--repeats", "0"], "repeats"),
        (&["repose", "--readings", "65"], "readings: must be from 1 to 64"),
        (&["repose", "--particles", "199"], "particles: must be from 200 to 20000"),
        (&["repose", "--weight", "3"], "--weight"),
        (&["repose", "--compat", "flex"], "--compat"),
        (&["bench", "sim", "--windows", "0"], "windows: must be from 1 to 100"),
        (&["bench", "sim", "--sizes", "2000,99"], "sizes: must be from 100 to 200000"),
        (
            &["bench", "bed", "--particles", "99", "bed.csv"],
            "particles: must be from 100 to 200000",
        ),
        (&["calibrate", "--powder", "chalk"], "powder"),
        (&["calibrate", "--powder", "salt", "--sets", "0"], "sets"),
        (&["calibrate", "--powder", "salt", "--tolerance-deg", "inf"], "tolerance_deg"),
        (&["calibrate", "--repose-deg", "90"], "repose_deg"),
        (&["calibrate", "--repose-deg", "30", "--sd-deg", "2", "--n", "0"], "n: must be from 1"),
        (&["calibrate", "--powder", "salt", "--repose-deg", "30"], "--repose-deg"),
        (&["measurements", "import", "nowhere.csv"], "file: nowhere.csv cannot be read"),
        (&["measurements", "export", "--powder", "chalk"], "powder"),
        (&["train", "--order", "sideways"], "--order"),
        (&["train", "--episodes", "0"], "episodes"),
        (
            &["train", "--order", "curriculum", "--episodes", "20", "--surrogate-episodes", "21"],
            "surrogate_episodes",
        ),
        (&["weigh", "--powder", "salt", "--target-mg", "-5"], "target_mg"),
        (&["weigh", "--powder", "chalk", "--target-mg", "5"], "powder"),
        (&["serve", "--listen", "0.0.0.0:0"], "listen: 0.0.0.0:0"),
        (&["policy", "show", "--policy", "p-0"], "policy: there is no policy"),
        (&["policy", "infer", "--file", "gone.safetensors", "--stdin"], "file: gone.safetensors"),
        (
            &["discover", "--measurements", "nowhere.csv", "--out", "found"],
            "measurements: nowhere.csv cannot be read",
        ),
        (&["discover", "--measurements", "m.csv"], "--out"),
        (
            &["discover", "--traces", "nowhere.csv", "--out", "found"],
            "traces: nowhere.csv cannot be read",
        ),
        (&["discover", "--out", "found"], "--measurements"),
        (
            &["evaluate", "--extension", "rotation"],
            "extension: must be a name, an equals sign and a number",
        ),
    ];
    for (arguments, named) in cases {
        let output = flip(folder.path(), arguments);
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains(named),
            "{arguments:?} does not name {named}: {}",
            stderr(&output)
        );
        let output = flip(folder.path(), &[arguments, &["--json"]].concat());
        expect_status(&output, 2);
        assert_eq!(document(&output)["error"]["kind"], "bad_input", "{arguments:?}");
    }
}

#[test]
fn two_calibrations_are_compared_by_the_ids_that_jobs_lists() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    for seed in ["1", "2"] {
        let quick =
            ["--method", "sequential", "--sets", "2", "--tolerance-deg", "5", "--particles", "400"];
        let arguments =
            [&["calibrate", "--powder", "sand", "--seed", seed, "--json"], &quick[..]].concat();
        expect_status(&flip(data, &arguments), 0);
    }
    let jobs = document(&flip(data, &["jobs", "--json"]));
    let ids: Vec<&str> =
        jobs["items"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap()).collect();
    let compared = document(&flip(data, &["compare", ids[0], ids[1], "--json"]));
    assert_eq!(
        (&compared["calibration"]["id"], &compared["with"]["id"]),
        (&ids[0].into(), &ids[1].into())
    );
    assert_eq!(compared["with"]["parameters"].as_array().unwrap().len(), 9);
    let text = flip(data, &["compare", ids[0], ids[1]]);
    expect_status(&text, 0);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("friction") && text.contains("mean angles differ by"), "{text}");
    expect_status(&flip(data, &["compare", ids[0], "none"]), 2);
}

#[test]
fn several_seeds_are_several_trainings() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let quick =
        ["--method", "sequential", "--sets", "2", "--tolerance-deg", "5", "--particles", "400"];
    expect_status(&flip(data, &[&["calibrate", "--powder", "sand"], &quick[..]].concat()), 0);
    let train = |seeds: &[&str]| {
        let small = [
            "train",
            "--powders",
            "sand",
            "--episodes",
            "4",
            "--surrogate-episodes",
            "4",
            "--json",
        ];
        let output = flip(data, &[&small[..], seeds].concat());
        expect_status(&output, 0);
        document(&output)
    };
    let both = train(&["--seeds", "3,4"]);
    assert_eq!((&both[0]["seed"], &both[1]["seed"]), (&3.into(), &4.into()));
    assert_ne!(both[0]["policy"], both[1]["policy"]);
    assert_eq!(train(&["--seed", "4"])["policy"], both[1]["policy"]);
}

#[test]
fn measurements_come_from_a_file_and_go_back_into_one() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("bench.csv"));
    let text = "powder,repose_deg,drained_deg\nflour,46,38\nflour,48,40\n";
    std::fs::write(&file, text).unwrap();
    let import = ["measurements", "import", file.to_str().unwrap()];
    let unknown = flip(&data, &import);
    expect_status(&unknown, 2);
    assert!(
        stderr(&unknown).contains("row[2].powder: there is no powder `flour`"),
        "{}",
        stderr(&unknown)
    );
    let imported = document(&flip(&data, &[&import[..], &["--create", "--json"]].concat()));
    assert_eq!(
        (&imported["powders"][0], &imported["measurements"][0]["n"]),
        (&"flour".into(), &2.into())
    );
    let export = |data: &Path| {
        let output = flip(data, &["measurements", "export", "--powder", "flour"]);
        expect_status(&output, 0);
        output.stdout
    };
    let exported = export(&data);
    std::fs::write(&file, &exported).unwrap();
    let other = folder.path().join("other");
    expect_status(&flip(&other, &[&import[..], &["--create"]].concat()), 0);
    assert_eq!(export(&other), exported);
    let all = document(&flip(&data, &["measurements", "export", "--json"]));
    assert_eq!(
        (
            all["measurements"].as_array().unwrap().len(),
            all["observations"].as_array().unwrap().len()
        ),
        (11, 1)
    );
}

/// Twelve days, two runs each of three powders, which pile steeper on damper days.
fn campaign() -> String {
    let mut text = String::from("powder,repose_deg,session,relative_humidity_pct\n");
    for run in 0..72_u32 {
        let (day, powder) = (run / 6, (run % 3) as usize);
        let humidity = 30 + (day * 17) % 40;
        let noise = f64::from((run * 7919) % 100) / 50.0 - 1.0;
        let angle = [36.0, 31.0, 29.0][powder] + 0.125 * f64::from(humidity) + noise;
        text += &format!("{},{angle:.2},{day},{humidity}\n", ["salt", "sugar", "flour_7"][powder]);
    }
    text
}

#[test]
fn discover_writes_the_same_files_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.csv");
    std::fs::write(&file, campaign()).unwrap();
    let with = |threads: &str| {
        let (data, out) = (
            folder.path().join(format!("data{threads}")),
            folder.path().join(format!("a/found{threads}")),
        );
        let (file, out_name) = (file.to_str().unwrap(), out.to_str().unwrap());
        let (budget, simulations) = (["--budget-runs", "40"], ["--simulations", "99"]);
        let arguments = [
            &["discover", "--measurements", file, "--out", out_name, "--json"][..],
            &budget,
            &simulations,
        ]
        .concat();
        let output = command(&data, &arguments).env("RAYON_NUM_THREADS", threads).output().unwrap();
        expect_status(&output, 0);
        let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
        let mut report = document(&output);
        assert_eq!(
            report,
            serde_json::from_str::<Value>(&read("report.json")).unwrap(),
            "the document is the file"
        );
        assert!(report["wall_s"].as_f64().unwrap() > 0.0);
        report.as_object_mut().unwrap().remove("wall_s");
        let names = std::fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap());
        assert_eq!(
            names.collect::<std::collections::BTreeSet<_>>(),
            ["predict.csv", "report.html", "report.json"].map(str::to_owned).into()
        );
        (serde_json::to_string(&report).unwrap(), read("predict.csv"))
    };
    let (report, predicted) = with("1");
    assert_eq!((&report, &predicted), (&with("3").0, &with("3").1));
    let report: Value = serde_json::from_str(&report).unwrap();
    assert!(
        report["p_value"].as_f64().unwrap() <= 0.02 && report["verdict"].is_string(),
        "{report}"
    );
    assert_eq!(report["causes"][0]["family"], "moisture");
    assert_eq!(
        predicted.lines().next(),
        Some("row,powder,before_deg,before_sd_deg,after_deg,after_sd_deg")
    );
    assert_eq!(predicted.lines().count(), 73);
    assert!(predicted.lines().nth(3).unwrap().starts_with("4,flour_7,3"), "{predicted}");
}

#[test]
fn what_discover_accepts_is_a_simulator_that_other_commands_take() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("found"));
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/campaigns/humidity.csv");
    let out = out.to_str().unwrap();
    let few = ["--simulations", "99", "--budget-runs", "10"];
    let report = document(&flip(
        &data,
        &[&["discover", "--measurements", file, "--out", out, "--json"][..], &few].concat(),
    ));
    // Two powders, five heaps each: ten are too few to criticise the numerics as well.
    assert_eq!(
        (&report["simulator_runs"], report.get("numerics")),
        (&json!(10), None),
        "{}",
        report["sentence"]
    );
    let version = report["simulator_version"]["extended"].as_str().expect("accepted");

    let quick = [
        "--method",
        "sequential",
        "--sets",
        "1",
        "--particles",
        "600",
        "--tolerance-deg",
        "4",
        "--json",
    ];
    let calibrate =
        [&["calibrate", "--powder", "sand", "--simulator", version][..], &quick].concat();
    let powder = document(&flip(&data, &calibrate))["powders"][0].clone();
    assert_eq!(powder["under"], json!({"simulator": version}));
    // On the driest day, not on the average one of 28.5 deg.
    assert!((25.0..28.2).contains(&powder["target_deg"].as_f64().unwrap()), "{powder}");

    let bench = ["--simulator", version, "--condition", "relative_humidity_pct=60"];
    let evaluate = [
        "evaluate",
        "--powders",
        "sand",
        "--targets-mg",
        "5",
        "--controllers",
        "fixed",
        "--repeats",
        "1",
    ];
    let evaluated = document(&flip(&data, &[&evaluate[..], &bench, &["--json"]].concat()));
    let conditions = json!({"relative_humidity_pct": 60.0});
    assert_eq!(evaluated["under"], json!({"simulator": version, "conditions": conditions}));
    let weigh = ["weigh", "--powder", "sand", "--target-mg", "5"];
    let weighed = document(&flip(&data, &[&weigh[..], &bench, &["--json"]].concat()));
    assert_eq!(weighed["under"]["conditions"], conditions);

    let refused = |arguments: &[&str], named: &str| {
        let output = flip(&data, arguments);
        expect_status(&output, 2);
        assert!(stderr(&output).contains(named), "{named}: {}", stderr(&output));
    };
    refused(&[&weigh[..], &bench[..2]].concat(), "conditions.relative_humidity_pct: is missing");
    refused(&[&weigh[..], &bench[2..]].concat(), "--simulator");
    refused(&[&weigh[..], &["--simulator", "sv-0"]].concat(), "there is no version `sv-0`");
    refused(
        &[&weigh[..], &["--simulator", version, "--condition", "wet"]].concat(),
        "relative_humidity_pct=65",
    );
}

#[test]
fn discover_asks_which_day_is_meant_and_says_how_it_read_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("m.csv"), folder.path().join("found"));
    let slashed = |(k, line): (usize, &str)| {
        let cells: Vec<&str> = line.split(',').collect();
        let day =
            cells[2].parse().map_or(cells[2].to_owned(), |day: u32| format!("3/{}/2026", day + 1));
        let humidity = if k == 7 { "NA" } else { cells[3] };
        format!("{};{};{day};{humidity}\n", cells[0], cells[1].replace('.', ","))
    };
    let rows: String = campaign().lines().enumerate().map(slashed).collect();
    std::fs::write(&file, format!("sep=;\r\n{rows}{}\u{1a}", rows.lines().last().unwrap()))
        .unwrap();
    let (data, quick) = (folder.path().join("data"), ["--simulations", "99", "--budget-runs", "0"]);
    let discover =
        ["discover", "--measurements", file.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let asked = flip(&data, &[&discover[..], &quick].concat());
    expect_status(&asked, 2);
    assert!(stderr(&asked).contains("row[2].session: `3/1/2026`"), "{}", stderr(&asked));
    let output = flip(&data, &[&discover[..], &quick, &["--dates", "month-first"]].concat());
    expect_status(&output, 0);
    let text = String::from_utf8(output.stdout).unwrap();
    for said in [
        "column of measurements",
        "12 days, 2026-03-01 to 2026-03-12",
        "the mean of its session stands in",
    ] {
        assert!(text.contains(said), "{said} is missing in {text}");
    }
}

#[test]
fn discover_of_one_to_five_sessions_says_that_it_cannot_judge_and_what_that_takes() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out, data) =
        (folder.path().join("m.csv"), folder.path().join("found"), folder.path().join("data"));
    for sessions in [1, 5] {
        let run = |k: usize| {
            format!("{},3{}.{},{}\n", ["salt", "sugar"][k % 2], k % 7, k % 10, k % sessions)
        };
        let rows: String = (0..40).map(run).collect();
        std::fs::write(&file, format!("powder,repose_deg,session\n{rows}")).unwrap();
        let quick = ["--simulations", "99", "--budget-runs", "0"];
        let discover =
            ["discover", "--measurements", file.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let output = flip(&data, &[&discover[..], &quick].concat());
        expect_status(&output, 0);
        let text = String::from_utf8(output.stdout).unwrap();
        for said in [
            "These angles cannot be judged",
            "It takes runs of the same powders on 6 days or more",
            "angles not judged",
        ] {
            assert!(text.contains(said), "{said} is missing in {text}");
        }
        // The job's report reads back unchanged.
        let jobs = document(&flip(&data, &["jobs", "--json"]));
        assert!(
            jobs["items"].as_array().unwrap().iter().all(|job| job["state"] == "succeeded"),
            "{jobs}"
        );
        let report: Value =
            serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
        assert!(
            report["unjudged"].is_string() && report["null_check"]["campaigns"] == 0,
            "{report}"
        );
        assert!(
            std::fs::read_to_string(out.join("report.html"))
                .unwrap()
                .contains("Could not be judged")
        );
    }
}

#[test]
fn discover_prints_a_text_and_refuses_a_bad_file_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("m.csv"), folder.path().join("found"));
    let (data, arguments) = (
        folder.path().join("data"),
        [
            "discover",
            "--measurements",
            file.to_str().unwrap(),
            "--simulations",
            "99",
            "--budget-runs",
            "0",
            "--out",
            out.to_str().unwrap(),
        ],
    );
    let latin = [campaign().as_bytes(), b"salt,36,12,40\nsucr\xe9,36,12,40\n"].concat();
    let steep = campaign().replacen("sugar,3", "sugar,93", 1);
    let few: String = campaign().lines().take(15).map(|line| format!("{line}\n")).collect();
    for (bytes, named) in [
        (steep.as_bytes(), "row[3].repose_deg: must be a number from 5 to 85 deg"),
        (&latin, "row[75]: is not UTF-8 text"),
        (few.as_bytes(), "measurements: 14 runs of 3 powders say nothing"),
    ] {
        std::fs::write(&file, bytes).unwrap();
        let output = flip(&data, &arguments);
        expect_status(&output, 2);
        assert!(stderr(&output).contains(named), "{named}: {}", stderr(&output));
    }
    assert!(!out.exists());
    assert_eq!(document(&flip(&data, &["jobs", "--json"]))["items"], json!([]));

    std::fs::write(&file, campaign()).unwrap();
    let output = flip(&data, &arguments);
    expect_status(&output, 0);
    let text = String::from_utf8(output.stdout).unwrap();
    for said in [
        "verdict ",
        "p = 0.01",
        "moisture",
        "rest_min was not recorded",
        "report.json and predict.csv are in",
    ] {
        assert!(text.contains(said), "{said} is missing in {text}");
    }
    assert_eq!(
        document(&flip(&data, &["jobs", "--kind", "investigation", "--json"]))["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    a_version_is_used_and_rolled_back(&data, &file);
}

/// On a data folder with one version of the simulator, and the file that made it.
fn a_version_is_used_and_rolled_back(data: &Path, file: &Path) {
    let versions = document(&flip(data, &["discover", "versions", "--json"]));
    let version = versions[0]["id"].as_str().unwrap();
    let predict = ["discover", "predict", "--measurements", file.to_str().unwrap()];
    let refused = flip(data, &predict);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("simulator: is the base now"), "{}", stderr(&refused));
    let none = flip(data, &["discover", "use", "sv-0"]);
    expect_status(&none, 2);
    assert!(
        stderr(&none).contains("simulator: must be `base` or an existing version"),
        "{}",
        stderr(&none)
    );
    for (chosen, before) in
        [(version, "base"), (version, "base"), ("base", version), (version, "base")]
    {
        let now = document(&flip(data, &["discover", "use", chosen, "--json"]));
        assert_eq!((&now["simulator"], &now["before"]), (&json!(chosen), &json!(before)));
    }
    let text = String::from_utf8(flip(data, &["discover", "versions"]).stdout).unwrap();
    assert!(
        text.contains(&format!("current: {version} since ")) && text.contains(", before that base"),
        "{text}"
    );
    let by_current = flip(data, &predict);
    expect_status(&by_current, 0);
    assert_eq!(
        by_current.stdout,
        flip(data, &[&predict[..], &["--simulator", version]].concat()).stdout
    );
}

/// Sixteen weighings of six shakes, eight readings each, and a log of the empty pan, by a balance
/// that drifts by this many mg/s.
fn weighings(drift: f64) -> String {
    let mut text = String::from("weighing_id,t_s,balance_mg,shake_index,kind\n");
    let noise =
        |reading: u32| f64::from((reading * 7919 + reading * reading * 31) % 101) / 500.0 - 0.1;
    for reading in 0..16 * 56_u32 {
        let (weighing, k) = (reading / 56, reading % 56);
        let (shake, t) = (k / 8, 0.5 * f64::from(k));
        let load = f64::from(shake) * (1.5 + 0.02 * f64::from((weighing * 37 + shake * 11) % 23));
        text += &format!("w{weighing},{t},{:.2},{shake},dose\n", load + drift * t + noise(reading));
    }
    let empty = |k: u32| format!("z,{k},{:.2},,zero\n", drift * f64::from(k) + noise(1000 + k));
    text + &(0..60).map(empty).collect::<String>()
}

#[test]
fn discover_reads_balance_readings_alone_and_refuses_a_bad_file_by_row_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file, out) =
        (folder.path().join("data"), folder.path().join("t.csv"), folder.path().join("found"));
    let (traces, folder_out) = (file.to_str().unwrap(), out.to_str().unwrap());
    let arguments = ["discover", "--traces", traces, "--simulations", "99", "--out", folder_out];
    let few: String = weighings(0.0).lines().take(20).map(|line| format!("{line}\n")).collect();
    for (text, named) in [
        (
            weighings(0.0).replacen("w0,1.5,", "w0,0.5,", 1),
            "traces.row[5].t_s: runs backwards in weighing `w0`",
        ),
        (weighings(0.0).replacen("w0,1.5,", "w0,soon,", 1), "traces.row[5].t_s: must be a number"),
        (
            weighings(0.0).replacen("balance_mg", "mass", 1),
            "traces.balance_mg: is missing in the header",
        ),
        (few, "traces: 19 readings say nothing: at least 30 are needed"),
    ] {
        std::fs::write(&file, text).unwrap();
        let output = flip(&data, &arguments);
        expect_status(&output, 2);
        assert!(stderr(&output).contains(named), "{named}: {}", stderr(&output));
    }
    assert!(!out.exists());
    assert_eq!(document(&flip(&data, &["jobs", "--json"]))["items"], json!([]));

    std::fs::write(&file, weighings(0.03)).unwrap();
    let report = document(&flip(&data, &[&arguments[..], &["--json"]].concat()));
    assert_eq!(
        (&report["verdict"], &report["causes"][0]["mechanism"]),
        (&"cause".into(), &"balance_drift".into()),
        "{report}"
    );
    let finding = &report["findings"][0];
    assert_eq!((&finding["channel"], &finding["unit"]), (&"trace".into(), &"mg".into()));
    let rate = &report["causes"][0]["parameters"][1];
    assert_eq!((&rate["name"], &rate["unit"]), (&"rate".into(), &"mg/s".into()));
    let [low, high] = [0, 1].map(|k| rate["ci95"][k].as_f64().unwrap());
    assert!(low < 0.03 && 0.03 < high && low > 0.02 && high < 0.04, "{rate}");
    assert_eq!(
        (&report["traces"]["weighings"], &report["traces"]["controls"]),
        (&16.into(), &1.into())
    );
    let jobs = document(&flip(&data, &["jobs", "--kind", "investigation", "--json"]));
    assert_eq!(jobs["items"].as_array().unwrap().len(), 1, "the same again is the same job");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(
        page.contains("<h2>Balance readings</h2>") && page.contains("the balance drifts"),
        "{page}"
    );
    assert_eq!(
        std::fs::read_to_string(out.join("predict.csv")).unwrap().lines().count(),
        1,
        "there are no angles"
    );
}

#[test]
fn a_policy_that_does_not_exist_exits_2_before_anything_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["weigh", "--powder", "salt", "--target-mg", "15"] as &[&str], &["evaluate"]]
    {
        let output = flip(folder.path(), &[arguments, &["--policy", "p-0"]].concat());
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains("there is no policy `p-0`"),
            "{arguments:?}: {}",
            stderr(&output)
        );
    }
}

#[test]
fn a_fresh_data_folder_is_made_and_seeded_by_whatever_comes_first() {
    let folder = tempfile::tempdir().unwrap();
    let fresh = folder.path().join("a").join("b");
    let output = flip(&fresh, &["jobs", "--json"]);
    expect_status(&output, 0);
    assert_eq!(document(&output)["items"], Value::Array(vec![]));
    let databases = std::fs::read_dir(&fresh).unwrap().filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().ends_with(".db")
    });
    assert_eq!(databases.count(), 1);
}

/// A running `flip serve`, killed when the test ends.
struct Service {
    process: Child,
    document: Value,
}

impl Service {
    fn start(data_dir: &Path) -> Self {
        let mut command = command(data_dir, &["serve", "--listen", "127.0.0.1:0", "--json"]);
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut text = String::new();
        // The document is printed once the service listens, and ends with the brace in the first
        // column.
        for line in BufReader::new(process.stdout.take().unwrap()).lines() {
            let line = line.unwrap();
            text.push_str(&line);
            if line == "}" {
                break;
            }
        }
        let document = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text:?}"));
        Self { process, document }
    }

    fn address(&self) -> String {
        self.document["url"].as_str().unwrap().trim_start_matches("http://").to_owned()
    }

    /// Sends SIGTERM, as systemd and Docker do, and returns its exit status.
    fn terminate(mut self) -> Option<i32> {
        let kill = format!("kill -TERM {}", self.process.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        self.process.wait().unwrap().code()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Already ended in most tests; then there is nothing to kill.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn while_a_server_holds_the_database_writers_exit_2_and_readers_read() {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(folder.path());
    for arguments in
        [&["calibrate", "--powder", "salt"] as &[&str], &["serve", "--listen", "127.0.0.1:0"]]
    {
        let output = flip(folder.path(), arguments);
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains("holds this database"),
            "{arguments:?}: {}",
            stderr(&output)
        );
    }
    let jobs = flip(folder.path(), &["jobs", "--json"]);
    expect_status(&jobs, 0);
    assert!(document(&jobs)["items"].is_array());
    let health = flip(folder.path(), &["health", "--listen", &service.address()]);
    expect_status(&health, 0);
    assert_eq!(service.terminate(), Some(0));
}

#[test]
fn a_latched_bench_of_devices_is_not_cleared_by_a_command_that_has_another_bench() {
    let folder = tempfile::tempdir().unwrap();
    expect_status(&flip(folder.path(), &["bench", "status"]), 0);
    let latch = "INSERT INTO latch (at, reason, bench) VALUES (1, 'a device failed', 'devices')";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options =
            sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        sqlx::query(latch).execute(&pool).await.unwrap();
        pool.close().await;
    });
    let clear = ["bench", "clear", "--by", "Ada", "--looked", "--vial-ready"];
    let refused = flip(folder.path(), &clear);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("--bench FILE"), "{}", stderr(&refused));
    let status = document(&flip(folder.path(), &["bench", "status", "--json"]));
    assert_eq!(
        (&status["latch"]["reason"], &status["held"]),
        (&json!("a device failed"), &json!(null))
    );
}

#[test]
fn a_bench_is_reserved_and_released_on_the_command_line_and_only_a_held_one_is_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let refused = flip(folder.path(), &["bench", "resume", "--by", "Ada"]);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("not held"), "{}", stderr(&refused));
    let reserved = document(&flip(
        folder.path(),
        &["bench", "reserve", "--owner", "Ada", "--seconds", "600", "--json"],
    ));
    let id = reserved["id"].as_str().unwrap();
    let status = document(&flip(folder.path(), &["bench", "status", "--json"]));
    assert_eq!(status["reservation"], reserved);
    expect_status(&flip(folder.path(), &["bench", "release", id]), 0);
    expect_status(&flip(folder.path(), &["bench", "release", id]), 2);
}

#[test]
fn the_first_start_shows_a_token_and_later_ones_none() {
    let folder = tempfile::tempdir().unwrap();
    let first = Service::start(folder.path());
    assert!(first.document["token"].as_str().unwrap().starts_with("flip_"));
    assert_eq!(first.terminate(), Some(0));
    let second = Service::start(folder.path());
    assert_eq!(second.document["token"], Value::Null);
    assert_eq!(second.terminate(), Some(0));
}

#[test]
fn tokens_are_made_with_a_role() {
    let folder = tempfile::tempdir().unwrap();
    let output = flip(folder.path(), &["token", "create", "--role", "operator", "--json"]);
    expect_status(&output, 0);
    assert_eq!(document(&output)["role"], "operator");
    assert!(document(&output)["token"].as_str().unwrap().starts_with("flip_"));
}

#[test]
fn bench_writes_the_same_bed_twice_as_centres_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let bed = || {
        let file = folder.path().join("bed.csv");
        let output = flip(
            folder.path(),
            &["bench", "bed", "--particles", "150", file.to_str().unwrap(), "--json"],
        );
        expect_status(&output, 0);
        assert_eq!(document(&output)["particles"], 150);
        std::fs::read_to_string(file).unwrap()
    };
    let first = bed();
    assert_eq!(first.lines().count(), 150);
    for line in first.lines() {
        let centre: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert!(
            centre.len() == 3 && centre.iter().all(|m| m.abs() < 0.005) && centre[2] > 0.0001,
            "{line}"
        );
    }
    assert_eq!(first, bed());
}

/// A policy file with a PID rule in which only the sum tilts and only the error shakes: its answers
/// can be computed by hand.
fn policy_file(folder: &Path) -> String {
    let gains = |p, i| Gains { p, i, d: 0.0 };
    let pid = Pid { incline: gains(0.0, 0.01), shake: gains(0.05, 0.0) };
    let manifest = Manifest::of_untrained(Kind::Pid { gains: pid }, Rules::FLIP, 0);
    let file = folder.join("pid.safetensors");
    std::fs::write(&file, policy::encode(&Policy { manifest, controller: Controller::Pid(pid) }))
        .unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_policy_out_of_a_file_answers_once_with_its_history_or_line_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = policy_file(folder.path());
    let seen =
        |reading_mg: f64, pitch_deg: f64| Observation { reading_mg, target_mg: 10.0, pitch_deg };
    let infer = |more: &[&str]| {
        let asked = [
            "policy",
            "infer",
            "--file",
            &file,
            "--target-mg",
            "10",
            "--pitch-deg",
            "0.8",
            "--reading-mg",
            "4",
        ];
        flip(folder.path(), &[&asked[..], more].concat())
    };
    let expect = |answer: &Value, incline_change_deg: f64, shake_mm: f64, episode: &str| {
        assert!(
            (answer["incline_change_deg"].as_f64().unwrap() - incline_change_deg).abs() < 1e-9,
            "{answer}"
        );
        assert!((answer["shake_mm"].as_f64().unwrap() - shake_mm).abs() < 1e-9, "{answer}");
        assert_eq!(answer["episode"], episode);
    };
    // The sum needs the previously missing mass.
    let alone = infer(&["--json"]);
    expect_status(&alone, 2);
    assert!(
        stderr(&alone).contains("reading_mg: must be within 1 mg of the tare"),
        "{}",
        stderr(&alone)
    );
    // With the 10 mg missing before, the sum is 16.
    let action = flip_core::domain::bench::Action { incline_change_deg: 0.8, shake_mm: 8.0 };
    let history = folder.path().join("history.json");
    let steps = [Done { before: seen(0.0, 0.0), action, after: seen(4.0, 0.8) }];
    std::fs::write(&history, serde_json::to_string(&steps).unwrap()).unwrap();
    let remembered = infer(&["--json", "--history", history.to_str().unwrap()]);
    expect_status(&remembered, 0);
    expect(&document(&remembered), 1.28, 4.8, "running");
    assert!(
        String::from_utf8(infer(&["--history", history.to_str().unwrap()]).stdout)
            .unwrap()
            .contains("shake 4.80 mm")
    );
    let late = [Done { before: seen(3.0, 0.0), action, after: seen(4.0, 0.8) }];
    std::fs::write(&history, serde_json::to_string(&late).unwrap()).unwrap();
    assert!(
        stderr(&infer(&["--history", history.to_str().unwrap()]))
            .contains("history[0].before.reading_mg")
    );

    let lines = |lines: &[Value]| {
        let mut command = command(folder.path(), &["policy", "infer", "--file", &file, "--stdin"]);
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = process.stdin.take().unwrap();
        lines.iter().for_each(|line| writeln!(stdin, "{line}").unwrap());
        drop(stdin);
        process.wait_with_output().unwrap()
    };
    let course = [seen(0.0, 0.0), seen(4.0, 0.8), seen(9.5, 2.08)].map(|seen| json!(seen));
    let output = lines(&course);
    expect_status(&output, 0);
    let text = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), 3);
    expect(&answers[0], 0.8, 8.0, "running");
    expect(&answers[1], 1.28, 4.8, "running");
    expect(&answers[2], 1.32, 0.4, "terminated");
    let other_target = json!({ "reading_mg": 4.0, "target_mg": 12.0, "pitch_deg": 0.0 });
    for (line, named) in
        [(other_target, "target_mg: must stay 10 mg"), (json!({ "reading_mg": 4.0 }), "stdin[2]")]
    {
        let refused = lines(&[course[0].clone(), line]);
        expect_status(&refused, 2);
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
    }
}

#[test]
fn bytes_that_are_no_policy_and_numbers_that_no_bench_shows_are_refused_by_field() {
    let folder = tempfile::tempdir().unwrap();
    let file = policy_file(folder.path());
    let text = folder.path().join("text.safetensors");
    std::fs::write(&text, "no policy").unwrap();
    let steps = json!([{ "before": { "reading_mg": 0.0, "target_mg": 10.0, "pitch_deg": 0.0 },
        "action": { "incline_change_deg": 0.0, "shake_mm": -1.0 }, "after": { "reading_mg": 0.0, "target_mg": 10.0, "pitch_deg": 0.0 } }]);
    let history = folder.path().join("history.json");
    std::fs::write(&history, steps.to_string()).unwrap();
    let infer = |file: &str, pitch: &str, more: &[&str]| {
        let asked = [
            "policy",
            "infer",
            "--file",
            file,
            "--target-mg",
            "10",
            "--reading-mg",
            "4",
            "--pitch-deg",
            pitch,
        ];
        let output = flip(folder.path(), &[&asked[..], more].concat());
        expect_status(&output, 2);
        stderr(&output)
    };
    assert!(
        infer(text.to_str().unwrap(), "0", &[]).contains("file: this is not a safetensors file")
    );
    assert!(infer(&file, "91", &[]).contains("pitch_deg: must be a number from -90 to 90"));
    let refused = infer(&file, "0", &["--history", history.to_str().unwrap()]);
    assert!(refused.contains("history[0].action.shake_mm"), "{refused}");
}
