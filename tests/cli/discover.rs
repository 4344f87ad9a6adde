//! `flip discover`.

use crate::harness::{command, document, expect_status, flip, stderr};
use serde_json::{Value, json};
use std::path::Path;

/// Twelve days, a run each of three powders, which pile steeper on damper days.
fn campaign() -> String {
    let mut text = String::from("powder,repose_deg,session,relative_humidity_pct\n");
    for run in 0..36_u32 {
        let (day, powder) = (run / 3, (run % 3) as usize);
        let humidity = 30 + (day * 17) % 40;
        let noise = f64::from((run * 7919) % 100) / 50.0 - 1.0;
        let angle = [36.0, 31.0, 23.0][powder] + 0.125 * f64::from(humidity) + noise;
        text += &format!("{},{angle:.2},{day},{humidity}\n", ["salt", "sugar", "sand"][powder]);
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
        let (budget, simulations) = (["--budget-runs", "6"], ["--simulations", "99"]);
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
    assert_eq!(predicted.lines().count(), 37);
    assert!(predicted.lines().nth(3).unwrap().starts_with("4,sand,2"), "{predicted}");
}

#[test]
fn what_discover_accepts_is_a_simulator_that_other_commands_take() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("found"));
    let file = folder.path().join("m.csv");
    std::fs::write(&file, campaign()).unwrap();
    let (file, out) = (file.to_str().unwrap(), out.to_str().unwrap());
    let few = ["--simulations", "99", "--budget-runs", "6"];
    let report = document(&flip(
        &data,
        &[&["discover", "--measurements", file, "--out", out, "--json"][..], &few].concat(),
    ));
    // Five heaps of a powder are too few to criticise the numerics as well.
    assert_eq!(
        (&report["simulator_runs"], report.get("numerics")),
        (&json!(5), None),
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
        (&latin, "row[39]: is not UTF-8 text"),
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
