//! Investigations: a campaign goes in, a report comes out, over both transports.

use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::investigations_client::InvestigationsClient;
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};
use std::time::Duration;
use tonic::{Code, Request};

const PATH: &str = "/v1/investigations";

pub async fn post(service: &Service, body: &Value) -> Response {
    let request = service.request("POST", PATH).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

async fn get(service: &Service, path: &str) -> Value {
    service.get(path).await.json().await.unwrap()
}

pub async fn as_operator<T>(service: &Service, message: T) -> Request<T> {
    let mut request = Request::new(message);
    let token = format!("Bearer {}", service.token(Role::Operator).await);
    request.metadata_mut().insert("authorization", token.parse().unwrap());
    request
}

/// Twelve days, each with its own humidity, three runs each of salt and sugar, which pile steeper
/// in damp air: 5 deg from 30 to 70 %, repeats of 1 deg.
pub fn humid_campaign() -> String {
    let mut text =
        String::from("powder,repose_deg,session,relative_humidity_pct,operator,remark\n");
    let mut state = 1_u64;
    let mut uniform = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    for day in 1..=12 {
        let humidity = 30.0 + 40.0 * uniform();
        for run in 0..6 {
            let (powder, centre) = if run % 2 == 0 { ("salt", 36.0) } else { ("sugar", 31.0) };
            let noise = 2.0 * (uniform() + uniform() + uniform() - 1.5);
            let angle = centre + 0.125 * (humidity - 50.0) + noise;
            let operator = if uniform() < 0.5 { "Ada" } else { "Ben" };
            text += &format!("{powder},{angle:.2},{day},{humidity:.1},{operator},{day}/{run}\n");
        }
    }
    text
}

/// The investigation once its job has succeeded.
pub async fn finished(service: &Service, id: &str) -> Value {
    for _ in 0..1200 {
        let found = get(service, &format!("{PATH}/{id}")).await;
        match found["job"]["state"].as_str().unwrap() {
            "succeeded" => return found,
            "queued" | "running" => tokio::time::sleep(Duration::from_millis(50)).await,
            state => panic!("{state}: {found}"),
        }
    }
    panic!("investigation {id} is not done in a minute")
}

#[tokio::test]
async fn a_campaign_is_judged_and_the_same_campaign_is_the_same_job() {
    let service = Service::start().await;
    let body = json!({ "measurements_csv": humid_campaign(), "simulations": 99 });
    let started = post(&service, &body).await;
    assert_eq!(started.status(), 202);
    let location = started.headers()["location"].to_str().unwrap().to_owned();
    let job: Value = started.json().await.unwrap();
    let id = job["id"].as_str().unwrap();
    assert_eq!(
        (job["kind"].as_str(), location.as_str()),
        (Some("investigation"), &*format!("{PATH}/{id}"))
    );

    let found = finished(&service, id).await;
    assert_eq!(
        (&found["powders"], &found["runs"], &found["sessions"]),
        (&json!(["salt", "sugar"]), &json!(72), &json!(12))
    );
    assert_eq!(
        found["covariates"],
        json!(["relative_humidity_pct", "operator"]),
        "a remark to each run says nothing"
    );
    let report = &found["report"];
    assert!(found["p_value"].as_f64().unwrap() <= 0.02, "{}", found["p_value"]);
    for name in ["verdict", "p_value", "sentence"] {
        assert_eq!(found[name], report[name], "{name}");
    }
    assert_eq!(
        (&report["schema_version"], &report["null_check"]["campaigns"]),
        (&json!(1), &json!(99))
    );
    assert_eq!(report["simulator_version"]["base"], found["simulator"]);
    assert_eq!(
        (&report["verdict"], &report["causes"][0]["mechanism"]),
        (&json!("cause"), &json!("humidity"))
    );
    let sentence = report["sentence"].as_str().unwrap();
    // Each named powder has its own effect next to its name.
    assert!(sentence.starts_with("Humidity makes salt and sugar pile steeper"), "{sentence}");
    assert!(sentence.contains("salt +") && sentence.contains("sugar +"), "{sentence}");
    let [low, high] = [0, 1].map(|k| report["findings"][0]["ci95"][k].as_f64().unwrap());
    // 0.125 deg for each percent of humidity between the percentiles of twelve days, which lie 15
    // to 40 % apart.
    assert!(low > 0.5 && low < 5.0 && high > 1.9, "{low} to {high}");
    assert!(report["wall_s"].as_f64().unwrap() > 0.0);

    let predicted = service.get(&format!("{PATH}/{id}/predict.csv")).await;
    assert_eq!(predicted.headers()["content-type"], "text/csv; charset=utf-8");
    let predicted = predicted.text().await.unwrap();
    let lines: Vec<&str> = predicted.lines().collect();
    assert_eq!(
        (lines.len(), lines[0]),
        (73, "row,powder,before_deg,before_sd_deg,after_deg,after_sd_deg")
    );
    assert!(lines[1].starts_with("2,salt,3") && lines[72].starts_with("73,sugar,3"), "{predicted}");

    let again = post(&service, &body).await;
    assert_eq!(again.status(), 200);
    assert_eq!(again.json::<Value>().await.unwrap()["id"], job["id"]);
    let other = post(
        &service,
        &json!({ "measurements_csv": humid_campaign(), "simulations": 99, "seed": 2 }),
    )
    .await;
    assert_eq!(other.status(), 202, "of another seed");
    finished(&service, other.json::<Value>().await.unwrap()["id"].as_str().unwrap()).await;
    let list = get(&service, PATH).await;
    let items = list["items"].as_array().unwrap();
    let seeds: Vec<_> = items.iter().map(|item| (&item["seed"], &item["report"])).collect();
    assert_eq!(
        seeds,
        [(&json!(2), &Value::Null), (&json!(1), &Value::Null)],
        "newest first, without their reports"
    );
    assert_eq!(items[1]["verdict"], found["verdict"]);
    assert_eq!(
        get(&service, "/v1/jobs?kind=investigation").await["items"].as_array().unwrap().len(),
        2
    );
}

#[tokio::test]
async fn what_is_stored_is_a_campaign_too() {
    let service = Service::start().await;
    let started = post(&service, &json!({ "simulations": 99 })).await;
    assert_eq!(started.status(), 202);
    let job: Value = started.json().await.unwrap();
    let found = finished(&service, job["id"].as_str().unwrap()).await;
    // The published means, five repeats each, by camera and by hand.
    assert_eq!(
        (&found["runs"], &found["sessions"], &found["covariates"]),
        (&json!(50), &json!(10), &json!(["method"]))
    );
    assert_eq!(found["report"]["rows"].as_array().unwrap().len(), 10);
}

/// Ten weighings of five shakes, six readings each, with nothing wrong, in file format.
fn weighings() -> String {
    let reading = |k: u32| {
        let (weighing, shake) = (k / 36, k % 36 / 6);
        let noise = f64::from((k * 7919 + k * k * 31) % 101) / 500.0 - 0.1;
        let load = f64::from(shake) * (1.4 + 0.03 * f64::from((weighing * 5 + shake * 3) % 13));
        format!("w{weighing},{},{:.2},{shake},salt\n", k % 36, load + noise)
    };
    "weighing_id,t_s,balance_mg,shake_index,powder\n".to_owned()
        + &(0..360).map(reading).collect::<String>()
}

#[tokio::test]
async fn balance_readings_are_judged_alone_and_beside_angles() {
    let service = Service::start().await;
    let start = async |body: &Value| {
        let started = post(&service, body).await;
        assert_eq!(started.status(), 202);
        started.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned()
    };
    let alone = start(&json!({ "traces_csv": weighings(), "simulations": 99 })).await;
    let both =
        start(&json!({ "measurements_csv": humid_campaign(), "traces_csv": weighings(), "simulations": 99 })).await;
    let mut client = InvestigationsClient::connect(service.url("")).await.unwrap();
    let request = proto::StartInvestigationRequest {
        traces_csv: Some(weighings()),
        simulations: Some(99),
        ..Default::default()
    };
    let again = client
        .start_investigation(as_operator(&service, request).await)
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        (again.created, again.job.unwrap().id),
        (false, alone.clone()),
        "the same over gRPC is the same job"
    );

    let found = finished(&service, &alone).await;
    assert_eq!(
        (&found["powders"], &found["runs"], &found["weighings"]),
        (&json!(["salt"]), &json!(0), &json!(10))
    );
    let report = &found["report"];
    assert_eq!((&report["rows"], &report["findings"]), (&json!([]), &json!([])), "{report}");
    assert_eq!(report["traces"]["shakes"], json!(50));
    assert_eq!(report["p_value"], report["traces"]["p_value"], "one channel needs no correction");
    let untestable = report["untestable"]
        .as_array()
        .unwrap()
        .iter()
        .find(|it| it["mechanism"] == "vibration_noise");
    assert_eq!(untestable.unwrap()["reason"], "vibration_rms_m_s2 was not recorded");

    let found = finished(&service, &both).await;
    let report = &found["report"];
    assert_eq!(report["findings"][0]["channel"], "repose");
    assert_eq!(
        (&report["traces"]["verdict"], &report["verdict"]),
        (&json!("no_discrepancy"), &json!("cause"))
    );
    // Of 100 sets each, the strongest of one: twice 0.01.
    assert_eq!(report["p_value"], json!(0.02));
    let named = |list: &str, key: &str, name: &str| {
        report[list].as_array().unwrap().iter().any(|it| it[key] == name)
    };
    assert!(named("evidence", "cause", "balance_drift") && named("evidence", "cause", "humidity"));
    assert!(!named("causes", "mechanism", "balance_drift"), "nothing is wrong with the balance");
    let sentence = report["sentence"].as_str().unwrap();
    assert!(
        sentence.starts_with("Humidity makes")
            && sentence.contains("Balance readings show no discrepancy"),
        "{sentence}"
    );
    // The version made from the angles requires the condition the angles depart with, and none of
    // the balance's.
    let version = report["simulator_version"]["extended"].as_str().unwrap();
    let ask = json!({ "measurements_csv": "powder,relative_humidity_pct\nsalt,32\n" });
    let path = format!("/v1/simulators/{version}/predictions");
    let answer = service
        .request("POST", &path)
        .bearer_auth(service.token(Role::Operator).await)
        .json(&ask)
        .send()
        .await
        .unwrap();
    assert_eq!(answer.status(), 200);
}

#[tokio::test]
async fn a_bad_campaign_is_refused_by_row_and_column_and_stores_nothing() {
    let service = Service::start().await;
    let humid = humid_campaign();
    let few: String = humid.lines().take(13).map(|line| format!("{line}\n")).collect();
    for (body, named) in [
        (json!({ "measurements_csv": "powder,angle\nsalt,36\n" }), &["repose_deg"] as &[&str]),
        (
            json!({ "measurements_csv": humid.replacen("salt,3", "salt,x3", 1) }),
            &["row[2].repose_deg"],
        ),
        (
            json!({ "measurements_csv": humid.replacen("salt,3", "salt,93", 1) }),
            &["row[2].repose_deg"],
        ),
        (json!({ "measurements_csv": humid.replacen(",Ada,", ",Ada,,", 1) }), &["row["]),
        (json!({ "measurements_csv": few }), &["measurements"]),
        (json!({ "measurements_csv": humid, "simulations": 98 }), &["simulations"]),
        (json!({ "measurements_csv": 7 }), &["measurements_csv"]),
        (json!({ "seed": -1 }), &["seed"]),
        (json!({ "traces": "" }), &["traces"]),
        (json!({ "traces_csv": "" }), &["traces.weighing_id", "traces.t_s", "traces.balance_mg"]),
        (
            json!({ "traces_csv": "weighing_id,t_s,balance_mg\nw,0,1\nw,-1,2\n" }),
            &["traces.row[3].t_s"],
        ),
        (
            json!({ "measurements_csv": humid, "traces_csv": "weighing_id,t_s,balance_mg\nw,0,1\n" }),
            &["traces"],
        ),
    ] {
        let problem = problem(post(&service, &body).await, 400).await;
        let fields = fields(&problem);
        let right = fields.len() == named.len()
            && fields.iter().zip(named).all(|(field, name)| field.starts_with(name));
        assert!(right, "{named:?}: {problem}");
    }
    problem(service.request("POST", PATH).json(&json!({})).send().await.unwrap(), 401).await;
    problem(service.get(&format!("{PATH}/none")).await, 404).await;
    problem(service.get(&format!("{PATH}/none/predict.csv")).await, 404).await;
    assert_eq!(get(&service, PATH).await["items"], json!([]));
    assert_eq!(get(&service, "/v1/jobs").await["items"], json!([]));
}

#[tokio::test]
async fn an_investigation_is_the_same_over_grpc() {
    let service = Service::start().await;
    let mut client = InvestigationsClient::connect(service.url("")).await.unwrap();
    let csv = humid_campaign();
    let request = proto::StartInvestigationRequest {
        measurements_csv: Some(csv.clone()),
        simulations: Some(99),
        ..Default::default()
    };
    let started = client
        .start_investigation(as_operator(&service, request).await)
        .await
        .unwrap()
        .into_inner();
    let job = started.job.unwrap();
    assert_eq!((started.created, job.kind()), (true, proto::JobKind::Investigation));
    let again =
        post(&service, &json!({ "measurements_csv": csv, "simulations": 99, "seed": 1 })).await;
    assert_eq!(again.status(), 200, "the same over REST is the same job");

    let rest = finished(&service, &job.id).await;
    let get = proto::GetInvestigationRequest { id: job.id.clone() };
    let found = client.get_investigation(get).await.unwrap().into_inner();
    let report: Value = serde_json::from_str(found.report_json()).unwrap();
    assert_eq!(report, rest["report"]);
    let name = found.verdict().as_str_name().to_lowercase();
    assert_eq!(name.strip_prefix("verdict_"), rest["verdict"].as_str());
    let of_grpc = json!({
        "powders": found.powders, "runs": found.runs, "sessions": found.sessions, "covariates": found.covariates,
        "simulations": found.simulations, "seed": found.seed, "simulator": found.simulator, "p_value": found.p_value,
        "sentence": found.sentence,
    });
    for (name, value) in of_grpc.as_object().unwrap() {
        assert_eq!(value, &rest[name], "{name}");
    }
    let list = client
        .list_investigations(proto::ListInvestigationsRequest { page: None })
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        list.items.iter().map(|item| (item.seed, item.report_json.is_some())).collect::<Vec<_>>(),
        [(1, false)]
    );

    let bad = proto::StartInvestigationRequest {
        measurements_csv: Some("powder\nsalt\n".into()),
        ..Default::default()
    };
    let status = client.start_investigation(as_operator(&service, bad).await).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    assert!(status.message().contains("repose_deg"), "{status}");
    let none = client
        .get_investigation(proto::GetInvestigationRequest { id: "none".into() })
        .await
        .unwrap_err();
    assert_eq!(none.code(), Code::NotFound);
}

#[tokio::test]
async fn an_extension_that_wins_is_a_version_that_predicts_and_the_report_is_a_page() {
    let service = Service::start().await;
    let body = json!({ "measurements_csv": humid_campaign(), "simulations": 99 });
    let id = post(&service, &body).await.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let found = finished(&service, &id).await;
    let version = found["report"]["simulator_version"]["extended"].as_str().unwrap().to_owned();
    let listed = get(&service, "/v1/simulators").await;
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
    let one = get(&service, &format!("/v1/simulators/{version}")).await;
    assert_eq!(one, listed["items"][0]);
    assert_eq!((&one["investigation"], &one["base"]), (&json!(id), &found["simulator"]));
    assert_eq!(one["body"]["causes"][0]["mechanism"], "humidity");
    assert_eq!(one["body"]["verified"], false, "no simulation confirmed it");
    problem(service.get("/v1/simulators/sv-0").await, 404).await;

    let path = format!("/v1/simulators/{version}/predictions");
    let ask = async |csv: &str| {
        let request =
            service.request("POST", &path).bearer_auth(service.token(Role::Operator).await);
        request.json(&json!({ "measurements_csv": csv })).send().await.unwrap()
    };
    let answer = ask("powder,relative_humidity_pct\nsalt,32\nsalt,68\nlactose,68\n").await;
    let text = answer.text().await.unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let number = |row: usize, column: usize| rows[row][column].parse::<f64>().unwrap();
    assert_eq!((rows.len(), rows[0][0], rows[2][1]), (3, "2", "lactose"));
    assert!(
        (number(0, 2) - number(1, 2)).abs() < 1e-9,
        "as it was, the simulator knows one angle of salt: {text}"
    );
    assert!(number(1, 4) - number(0, 4) > 2.5, "{text}");
    assert_eq!(rows[2][2], "", "nothing is known of lactose: {text}");
    let refused = problem(ask("powder\nsalt\n").await, 400).await;
    assert_eq!(fields(&refused), ["measurements"]);
    assert!(refused.to_string().contains("relative_humidity_pct"), "{refused}");

    let page = service.get(&format!("{PATH}/{id}/report.html")).await;
    let policy = page.headers()["content-security-policy"].to_str().unwrap().to_owned();
    assert!(policy.starts_with("default-src 'none'; style-src 'unsafe-inline'"), "{policy}");
    let page = page.text().await.unwrap();
    assert!(
        page.contains("Humidity makes ")
            && page.contains(" pile steeper")
            && !page.contains("<script")
    );
    let sections = service.get(&format!("{PATH}/{id}/report.html?fragment=true")).await;
    let sections = sections.text().await.unwrap();
    assert!(sections.contains("<p class=\"sentence\">Humidity makes "), "{sections}");
    assert!(!sections.contains("<html") && !sections.contains("<style"), "{sections}");
    let refused =
        problem(service.get(&format!("{PATH}/{id}/report.html?fragment=perhaps")).await, 400);
    assert_eq!(fields(&refused.await), ["fragment"]);
}

/// 200 weighings of ten shakes, ten readings each: 20000 rows, more than a megabyte.
fn many_weighings() -> String {
    let reading = |k: u32| {
        let (weighing, shake) = (k / 100, k % 100 / 10);
        let noise = f64::from((k * 7919 + k % 1000 * 31) % 101) / 500.0 - 0.1;
        let load = f64::from(shake) * (1.4 + 0.03 * f64::from((weighing * 5 + shake * 3) % 13));
        format!(
            "weighing-{weighing:04}-of-the-first-campaign,{}.{},{:.4},{shake},3-Nitrotoluene,ST\r\n",
            k % 100,
            k % 10,
            load + noise
        )
    };
    "weighing_id,t_s,balance_mg,shake_index,powder,stable\r\n".to_owned()
        + &(0..20_000).map(reading).collect::<String>()
}

#[tokio::test]
async fn twenty_thousand_readings_are_taken_over_rest_and_grpc_alike() {
    let service = Service::start().await;
    let csv = many_weighings();
    assert!(csv.len() > 1024 * 1024);
    let posted = post(&service, &json!({ "traces_csv": csv, "simulations": 99 })).await;
    assert_eq!(posted.status(), 202);
    let job: Value = posted.json().await.unwrap();
    let mut client = InvestigationsClient::connect(service.url("")).await.unwrap();
    let request = proto::StartInvestigationRequest {
        traces_csv: Some(csv.replace(',', ";")),
        simulations: Some(99),
        ..Default::default()
    };
    let again = client
        .start_investigation(as_operator(&service, request).await)
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        (again.created, again.job.unwrap().id.as_str()),
        (false, job["id"].as_str().unwrap()),
        "with semicolons"
    );
    let path = format!("/v1/jobs/{}/cancel", job["id"].as_str().unwrap());
    let cancel = service
        .request("POST", &path)
        .bearer_auth(service.token(Role::Operator).await)
        .send()
        .await
        .unwrap();
    assert!(cancel.status().is_success());
    let one_more = format!("{}\r\nweighing-9999,0,0,0,salt,ST\r\n", many_weighings().trim_end());
    let refused = problem(post(&service, &json!({ "traces_csv": one_more })).await, 400).await;
    assert_eq!(fields(&refused), ["traces.row[20002]"]);
}

#[tokio::test]
async fn how_a_file_was_read_is_in_the_report_and_a_day_that_may_be_two_is_asked_for() {
    let service = Service::start().await;
    let mut lines: Vec<String> = humid_campaign().lines().map(str::to_owned).collect();
    let column = |name: &str| lines[0].split(',').position(|it| it == name).unwrap();
    let (session, humidity) = (column("session"), column("relative_humidity_pct"));
    for (k, line) in lines.iter_mut().enumerate().skip(1) {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let day: u32 = cells[session].parse().unwrap();
        cells[session] = format!("3/{day}/2026");
        if k == 5 {
            cells[humidity] = "NA".to_owned();
        }
        *line = cells.join(",");
    }
    let csv = lines.join("\n");
    let asked =
        problem(post(&service, &json!({ "measurements_csv": csv, "simulations": 99 })).await, 400)
            .await;
    assert_eq!(fields(&asked), ["row[2].session"]);
    assert!(asked.to_string().contains("`dates`"), "{asked}");
    let body = json!({ "measurements_csv": csv, "simulations": 99, "dates": "month_first" });
    let started: Value = post(&service, &body).await.json().await.unwrap();
    let found = finished(&service, started["id"].as_str().unwrap()).await;
    let read = &found["report"]["files"][0];
    assert_eq!((&read["file"], &read["rows"]), (&json!("measurements"), &json!(72)));
    let of = |name: &str| {
        read["columns"].as_array().unwrap().iter().find(|it| it["column"] == name).unwrap().clone()
    };
    assert_eq!(of("session")["note"], "12 days, 2026-03-01 to 2026-03-12");
    let humidity = of("relative_humidity_pct");
    assert_eq!(
        (&humidity["taken_as"], &humidity["filled"], &humidity["missing"]),
        (&json!("numbers"), &json!(71), &json!(1))
    );
    assert_eq!(
        found["report"]["findings"][0]["covariate"], "relative_humidity_pct",
        "one missing cell loses no column"
    );
    assert_eq!(of("remark")["taken_as"], "nothing");
    let page = service
        .get(&format!("{PATH}/{}/report.html", started["id"].as_str().unwrap()))
        .await
        .text()
        .await
        .unwrap();
    assert!(
        page.contains("How the data were read")
            && page.contains("12 days, 2026-03-01 to 2026-03-12")
    );
    let mut client = InvestigationsClient::connect(service.url("")).await.unwrap();
    let mut request = proto::StartInvestigationRequest {
        measurements_csv: Some(csv),
        simulations: Some(99),
        ..Default::default()
    };
    request.set_dates(proto::DateOrder::MonthFirst);
    let again = client
        .start_investigation(as_operator(&service, request).await)
        .await
        .unwrap()
        .into_inner();
    assert!(!again.created, "the same over gRPC is the same job");
}
