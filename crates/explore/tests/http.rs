//! Tests of the server by HTTP: access control and responses.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "everything here is a test"
)]

use crumple_sim::scenario::NoDriverFiles;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use crumple_explore::{CatalogScenario, CatalogSuite, ExploreConfig, Server};
use crumple_search::worst_case::{AvoidOptions, AvoidReport, avoid};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{built_in_scenario, file};
use proptest::prelude::*;
use serde_json::{Value, json};

/// Server of all tests, and its token.
struct TestServer {
    port: u16,
    token: String,
}

fn test_server() -> &'static TestServer {
    static SERVED: OnceLock<TestServer> = OnceLock::new();
    SERVED.get_or_init(|| {
        let wet = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.environment.friction = 0.8)
            .unwrap();
        let scenarios = vec![CatalogScenario {
            name: "wet".to_owned(),
            scenario: wet,
        }];
        let offer = ExploreConfig {
            scenarios,
            ..ExploreConfig::default()
        };
        let (port, token) = start(Server::bind(0, offer).unwrap());
        TestServer { port, token }
    })
}

/// Starts a server. Returns its port and its token.
fn start(server: Server) -> (u16, String) {
    let (port, address) = (server.port(), server.url());
    let token = address
        .strip_prefix(&format!("http://127.0.0.1:{port}/"))
        .unwrap()
        .trim_end_matches('/')
        .to_owned();
    std::thread::spawn(|| server.run().unwrap());
    (port, token)
}

/// Lock of tests with hundreds of connections; a process can have about a thousand.
static MANY_CONNECTIONS: Mutex<()> = Mutex::new(());

fn connect(port: u16) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(300)))
        .unwrap();
    stream
}

fn exchange(port: u16, request: &[u8]) -> (u16, String, Vec<u8>) {
    let mut stream = connect(port);
    // The server may respond and close before it has read everything.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let split = answer
        .windows(4)
        .position(|window| window == b"\r\n\r\n")
        .unwrap_or(answer.len());
    let head = String::from_utf8_lossy(&answer[..split]).into_owned();
    let status = head
        .split(' ')
        .nth(1)
        .and_then(|code| code.parse().ok())
        .unwrap_or(0);
    (
        status,
        head,
        answer.get(split + 4..).unwrap_or_default().to_vec(),
    )
}

fn request(method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Vec<u8> {
    let mut text = format!(
        "{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n",
        body.len()
    );
    for (name, value) in headers {
        text += &format!("{name}: {value}\r\n");
    }
    [text.as_bytes(), b"\r\n", body].concat()
}

/// Sends a request of the page, with the token.
fn post(what: &str, body: &[u8]) -> (u16, Value) {
    let TestServer { port, token, .. } = test_server();
    post_at(*port, token, what, body)
}

fn post_at(port: u16, token: &str, what: &str, body: &[u8]) -> (u16, Value) {
    let host = format!("127.0.0.1:{port}");
    let path = format!("/{token}/api/{what}");
    let sent = request(
        "POST",
        &path,
        &[("Host", &host), ("Content-Type", "application/json")],
        body,
    );
    let (status, _, answer) = exchange(port, &sent);
    (
        status,
        serde_json::from_slice(&answer).unwrap_or(Value::Null),
    )
}

fn run_request(edits: &Value) -> Value {
    json!({
        "scenario": built_in_scenario("paper-1").unwrap().spec(),
        "edits": edits,
        "controllers": ["baseline", "idm"],
        "estimator": "truth",
    })
}

#[test]
fn pages_require_the_token_and_load_nothing_external() {
    let TestServer { port, token, .. } = test_server();
    let host = format!("localhost:{port}");
    for (path, kind) in [
        ("", "text/html"),
        ("campaigns", "text/html"),
        ("recordings", "text/html"),
        ("suites", "text/html"),
        ("explore.css", "text/css"),
        ("explore.js", "text/javascript"),
    ] {
        let sent = request("GET", &format!("/{token}/{path}"), &[("Host", &host)], b"");
        let (status, head, body) = exchange(*port, &sent);
        let head = head.to_ascii_lowercase();
        assert_eq!(status, 200, "{path}");
        for header in [
            &*format!("content-type: {kind}"),
            "content-security-policy: default-src 'none'",
            "referrer-policy: no-referrer",
            "x-content-type-options: nosniff",
        ] {
            assert!(head.contains(header), "{header}: {head}");
        }
        let text = String::from_utf8(body)
            .unwrap()
            .replace("http://www.w3.org/2000/svg", "");
        for forbidden in ["http://", "https://", token.as_str()] {
            assert!(!text.contains(forbidden), "{path}: {forbidden}");
        }
    }
}

#[test]
fn without_the_token_or_from_another_page_every_request_is_refused() {
    let TestServer { port, token, .. } = test_server();
    let host = format!("127.0.0.1:{port}");
    let body = run_request(&json!({})).to_string();
    let own = [
        ("Host", host.as_str()),
        ("Content-Type", "application/json"),
    ];
    let wrong = "0".repeat(token.len());
    let pages = [
        "",
        "campaigns",
        "recordings",
        "suites",
        "explore.css",
        "explore.js",
        "nothing",
    ];
    for path in pages.into_iter().chain([
        "api/open",
        "api/open-test",
        "api/run",
        "api/avoid",
        "api/save",
        "api/campaign",
        "api/recording",
        "api/replay",
        "api/suite",
    ]) {
        for method in ["GET", "POST", "PUT", "OPTIONS"] {
            for address in [
                format!("/{path}"),
                format!("/{wrong}/{path}"),
                format!("/{}/{path}", &token[1..]),
                format!("//{token}/{path}"),
            ] {
                let sent = request(method, &address, &own, body.as_bytes());
                assert_eq!(exchange(*port, &sent).0, 403, "{method} {address}");
            }
            let address = format!("/{token}/{path}");
            for foreign in [
                [("Host", "rebound.example"), own[1], ("Accept", "*/*")],
                [own[0], own[1], ("Origin", "https://evil.example")],
                [own[0], own[1], ("Origin", "null")],
                [own[0], own[1], ("Sec-Fetch-Site", "cross-site")],
                [own[0], own[1], ("Sec-Fetch-Site", "same-site")],
            ] {
                let (status, head, answer) =
                    exchange(*port, &request(method, &address, &foreign, body.as_bytes()));
                assert_eq!(status, 403, "{method} {address} {foreign:?}");
                let error: Value = serde_json::from_slice(&answer).unwrap();
                assert_eq!(error["error"]["kind"], "forbidden");
                assert!(
                    !head.to_ascii_lowercase().contains("access-control"),
                    "{head}"
                );
            }
        }
    }
    // A form of another page can send these content types without a preflight request.
    for kind in ["text/plain", "application/x-www-form-urlencoded"] {
        let sent = request(
            "POST",
            &format!("/{token}/api/run"),
            &[("Host", &host), ("Content-Type", kind)],
            body.as_bytes(),
        );
        assert_eq!(exchange(*port, &sent).0, 415);
    }
}

#[test]
fn fifty_simultaneous_clients_receive_their_own_responses() {
    // Different scenarios detect mixed-up responses.
    let ask = |client: usize| {
        let name = format!("client {client}");
        let speed_mps = 15.0 + 0.3 * client as f64;
        let edits = json!({ "name": name, "vehicles": [{ "vehicle": 1, "speed_mps": speed_mps }] });
        (0..4)
            .map(|_| {
                let (status, answer) = post("run", run_request(&edits).to_string().as_bytes());
                assert_eq!(status, 200, "{answer}");
                assert_eq!(answer["sliders"]["name"], name);
                assert_eq!(answer["sliders"]["vehicles"][1]["speed_mps"], speed_mps);
                (
                    answer["runs"].clone(),
                    answer["figures"].as_str().unwrap().len(),
                )
            })
            .collect::<Vec<_>>()
    };
    let answers: Vec<_> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..50)
            .map(|client| scope.spawn(move || ask(client)))
            .collect();
        clients
            .into_iter()
            .map(|client| client.join().unwrap())
            .collect()
    });
    for (client, of_client) in answers.iter().enumerate() {
        assert_eq!(of_client.len(), 4);
        assert!(
            of_client.iter().all(|answer| answer == &of_client[0]),
            "client {client}"
        );
        assert_eq!(of_client[0].0[0]["controller"], "baseline");
    }
}

/// More idle connections than the server keeps do not delay a request until their time limit.
#[test]
fn idle_connections_do_not_block_others() {
    let _alone = MANY_CONNECTIONS.lock();
    let (port, token) = start_patient_server();
    let idle: Vec<_> = (0..400)
        .map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap())
        .collect();
    assert_eq!(post_at(port, &token, "open", br#"{"scenario": 0}"#).0, 200);
    drop(idle);
}

/// Starts a server whose time limit is an hour: a client that waits for it fails first.
fn start_patient_server() -> (u16, String) {
    let server = Server::bind(0, ExploreConfig::default()).unwrap();
    start(server.with_read_timeout(Duration::from_secs(3600)))
}

/// Sends a request without its body except for the first byte.
fn start_request(port: u16, token: &str) -> TcpStream {
    let mut stream = connect(port);
    let head = format!(
        "POST /{token}/api/open HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Type: application/json\r\n\
         Connection: close\r\nContent-Length: 15\r\n\r\n{{"
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream
}

fn finish_request(stream: &mut TcpStream) -> String {
    stream.write_all(br#""scenario": 0}"#).unwrap();
    read_response(stream)
}

fn read_response(stream: &mut TcpStream) -> String {
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

/// More slow requests than connections are allowed: the newest ones are answered without waiting for a time limit.
#[test]
fn slow_requests_do_not_block_other_clients() {
    let _alone = MANY_CONNECTIONS.lock();
    let (port, token) = start_patient_server();
    let mut bodies: Vec<_> = (0..130).map(|_| start_request(port, &token)).collect();
    let heads: Vec<_> = (0..130)
        .map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap())
        .collect();
    heads
        .iter()
        .for_each(|mut stream| stream.write_all(b"POST / HTTP/1.1\r\nHost: ").unwrap());
    bodies.extend((0..130).map(|_| start_request(port, &token)));
    for _ in 0..3 {
        assert!(finish_request(&mut start_request(port, &token)).starts_with("HTTP/1.1 200"));
    }
    assert!(finish_request(bodies.last_mut().unwrap()).starts_with("HTTP/1.1 200"));
}

#[test]
fn an_incomplete_request_times_out() {
    let (port, token) = start(
        Server::bind(0, ExploreConfig::default())
            .unwrap()
            .with_read_timeout(Duration::from_millis(200)),
    );
    let answer = read_response(&mut start_request(port, &token));
    assert!(
        answer.starts_with("HTTP/1.1 408") && answer.contains("longer than 0.2 s"),
        "{answer}"
    );
    let mut head = connect(port);
    head.write_all(b"POST / HTTP/1.1\r\nHost: ").unwrap();
    assert!(
        !read_response(&mut head).contains("200 OK"),
        "the connection ends"
    );
}

#[test]
fn errors_name_their_field() {
    let refused = |what: &str, body: &str, status: u16, output: &str| {
        let (found, answer) = post(what, body.as_bytes());
        let message = answer["error"]["message"].as_str().unwrap_or_default();
        assert!(
            found == status && message.contains(output),
            "{what} {body:.80}: {found} {answer}, and {output} is to be in it"
        );
    };
    refused("run", "", 400, "line 1");
    refused("run", "{", 400, "line 1");
    refused("run", &"[".repeat(200_000), 400, "line 1");
    refused("run", &format!("\"{}\"", "x".repeat(2 << 20)), 413, "KiB");
    for (object, field, value, status, output) in [
        ("", "colour", json!(3), 400, "colour"),
        (
            "/scenario/vehicles/0",
            "speed_mps",
            json!("fast"),
            400,
            "scenario.vehicles[0].speed_mps",
        ),
        (
            "/scenario/vehicles/0",
            "speed_mps",
            json!(-1.0),
            422,
            "scenario.vehicles[0].speed_mps",
        ),
        (
            "/edits",
            "friction",
            json!(7),
            422,
            "scenario.environment.friction",
        ),
        (
            "/edits",
            "vehicles",
            json!([{ "vehicle": 9 }]),
            422,
            "edits.vehicles[0].vehicle",
        ),
        (
            "/edits",
            "vehicles",
            json!([{ "vehicle": 0, "gap_m": 3.0 }]),
            422,
            "no vehicle is ahead",
        ),
        (
            "/edits",
            "vehicles",
            json!([{ "vehicle": 1, "gap_m": -3.0 }]),
            422,
            "overlaps",
        ),
        (
            "/edits",
            "lead",
            json!({ "from_s": [0.0], "accel_mps2": [-30.0] }),
            422,
            "raise its max_brake_mps2",
        ),
        ("", "controllers", json!([]), 422, "1 to 4"),
        ("", "controllers", json!(vec!["idm"; 5]), 422, "1 to 4"),
        ("/scenario", "duration_s", json!(1e4), 422, "vehicle-steps"),
    ] {
        let mut body = run_request(&json!({}));
        body.pointer_mut(object).unwrap()[field] = value;
        refused("run", &body.to_string(), status, output);
    }
    refused("open", r#"{"scenario": 99}"#, 422, "there are");
    refused(
        "open",
        r#"{"campaign": 0, "evaluation": 0}"#,
        422,
        "there are",
    );
    refused("open", "{}", 422, "either");
    refused("campaign", r#"{"campaign": 0}"#, 422, "there are");
    refused("recording", r#"{"recording": 0}"#, 422, "there are");
    refused(
        "suite",
        r#"{"suite": 0, "controllers": ["idm"]}"#,
        422,
        "there are",
    );
    let test = r#"{"suite": 0, "test": 0, "controller": 0, "point": {"failure": 0}}"#;
    refused("open-test", test, 422, "there are");
    let mut body = run_request(&json!({}));
    body["test_driver"] = json!("test-driver,hold=3:");
    refused("run", &body.to_string(), 422, "hold");
    let (status, answer) = post("nothing", b"{}");
    assert_eq!(
        (status, &answer["error"]["kind"]),
        (404, &json!("not-found"))
    );
}

/// A leader that brakes at 3 m/s² for two seconds, followed at a gap of 20 m by a driver who brakes a second later.
fn braking_csv() -> String {
    let mut text =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    let braking = |at_s: f64| 20.0 - 3.0 * at_s.clamp(0.0, 2.0);
    let mut gap_m = 20.0;
    for sample in 0..100 {
        let at_s = 0.1 * f64::from(sample);
        let [leader_mps, own_mps] = [braking(at_s - 3.0), braking(at_s - 4.0)];
        let closing_mps = leader_mps - own_mps;
        text += &format!("1,{at_s:.1},{gap_m:.3},{own_mps:.3},{closing_mps:.3},{leader_mps:.3}\n");
        gap_m += 0.1 * closing_mps;
    }
    text
}

/// The page shows the recorded drive, and the brakings of each controller as `crumple replay` finds them.
#[test]
fn a_recorded_drive_shows_the_brakings_of_controllers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.csv");
    std::fs::write(&path, braking_csv()).unwrap();
    let offer = ExploreConfig {
        recordings: vec![path.clone()],
        ..ExploreConfig::default()
    };
    let (port, token) = start(Server::bind(0, offer).unwrap());
    let ask = |what: &str, body: &Value| {
        let (status, answer) = post_at(port, &token, what, body.to_string().as_bytes());
        assert_eq!(status, 200, "{what}: {answer}");
        answer
    };
    assert_eq!(ask("recording", &json!({ "recording": 0 }))["count"], 1);
    let controllers = ["idm", "full-throttle"];
    let body = json!({ "recording": 0, "drive": 0, "controllers": controllers, "figure": true });
    let answer = ask("replay", &body);
    let recording = crumple_exchange::recording::load(&path, None).unwrap();
    for (index, name) in controllers.into_iter().enumerate() {
        let options = RunOptions::new(BuiltInController::from_name(name).unwrap())
            .with_estimator(EstimatorKind::Truth);
        let replayed =
            crumple_exchange::recording::replay::replay(&recording, &options, 1.3, &|_, _| ());
        let brakings = replayed.unwrap().remove(0).brakings;
        let counted = answer["counts"][index].as_str().unwrap();
        let hardest = brakings
            .iter()
            .map(|braking| braking.brake_mps2)
            .reduce(f64::max);
        let expected = hardest.map_or("never".to_owned(), |mps2| format!("{mps2:.1} m/s²"));
        assert!(
            counted.starts_with(name) && counted.contains(&expected),
            "{counted}: {expected}"
        );
        assert_eq!(brakings.is_empty(), name == "full-throttle");
    }
    let figure = answer["figure"].as_str().unwrap();
    for title in [
        "Recorded speed",
        "Recorded gap",
        "Acceleration, recorded and commanded",
        "Recorded time to collision",
        "commanded by full-throttle",
    ] {
        assert!(figure.contains(title), "{title}");
    }
    // The leader begins to brake at 3 s.
    let mut zoomed = body;
    zoomed["window_s"] = json!([2.0, 4.0]);
    assert_ne!(ask("replay", &zoomed)["figure"].as_str(), Some(figure));
    assert!(answer["brakings"].as_str().unwrap().contains("data-from"));
}

const SUITE: &str = r#"
version = 1
name = "behind"
about = "A vehicle stands."
document = "None"
edition = "1"
parameter_source = "Chosen."

[[clauses]]
clause = "1"
summary = "The vehicle ahead stands."

[[clauses.tests]]
name = "standing"
lead = "stopped"
holds_speed = true
margins = [{ parameter = "own_speed", to = 200.0 }]
parameters.own_speed = { values = [30.0, 190.0], unit = "km/h", origin = "chosen" }
parameters.closing_time = { values = [4.0], unit = "s", origin = "chosen" }

[[clauses.tests]]
name = "near"
lead = "stopped"
margins = [{ parameter = "closing_time", to = 0.2 }]
parameters.own_speed = { values = [30.0], unit = "km/h", origin = "chosen" }
parameters.closing_time = { values = [4.0], unit = "s", origin = "chosen" }
"#;

/// Each link of a suite opens a simulation that ends as the suite states, with the driver of the test.
#[test]
fn tests_of_a_suite_open_their_simulations() {
    let suite = crumple_suites::TestSuite::from_toml(SUITE, Path::new("behind.toml")).unwrap();
    let offer = ExploreConfig {
        suites: vec![CatalogSuite {
            name: "behind".to_owned(),
            suite,
        }],
        ..ExploreConfig::default()
    };
    let (port, token) = start(Server::bind(0, offer).unwrap());
    let ask = |what: &str, body: &Value| {
        let (status, answer) = post_at(port, &token, what, body.to_string().as_bytes());
        assert_eq!(status, 200, "{what}: {answer}");
        answer
    };
    let answer = ask(
        "suite",
        &json!({ "suite": 0, "controllers": ["baseline", "idm"] }),
    );
    let tests = answer["tests"].as_str().unwrap();
    assert!(answer["summaries"].to_string().contains("no certification"));
    assert!(
        tests.contains("margin of closing time at own speed 30 km/h"),
        "{tests}"
    );
    // `baseline` is the first controller of the page: it was selected.
    let open = |test: usize, point: Value| {
        ask(
            "open-test",
            &json!({ "suite": 0, "test": test, "controller": 0, "point": point }),
        )
    };
    for (test, point, verdict) in [
        (0, json!("first"), "safe"),
        (0, json!({ "failure": 0 }), "collision"),
        (1, json!("first"), "safe"),
        (1, json!({ "passes_at": 0 }), "safe"),
        (1, json!({ "fails_at": 0 }), "collision"),
    ] {
        if let Some((end, index)) = point.as_object().and_then(|point| point.iter().next()) {
            assert!(
                tests.contains(&format!("test={test}&amp;controller=0")),
                "{tests}"
            );
            assert!(tests.contains(&format!("&amp;{end}={index}\"")), "{tests}");
        }
        let opened = open(test, point.clone());
        let run = json!({
            "scenario": opened["scenario"],
            "controllers": [opened["controller"]],
            "test_driver": opened["test_driver"],
        });
        let ran = ask("run", &run);
        assert_eq!(
            ran["runs"][0]["verdict"], verdict,
            "{test} {point}: {opened}"
        );
        assert_eq!(opened["test_driver"].is_null(), test == 1, "{opened}");
    }
    let saved = json!({
        "edited": { "scenario": open(0, json!("first"))["scenario"] },
        "controller": "baseline",
        "test_driver": open(0, json!("first"))["test_driver"],
    });
    let command = ask("save", &saved)["command"].to_string();
    assert!(
        command.contains("test-driver,hold_mps=8.333333333333334:baseline"),
        "{command}"
    );
}

/// No name in a request opens a file or starts a process.
#[test]
fn no_name_in_a_request_is_a_file_or_a_command() {
    let folder = tempfile::tempdir().unwrap();
    let collided = folder.path().join("touched");
    for name in [
        format!("exec:touch {}", collided.display()),
        "shield:exec:true".to_owned(),
        "/etc/passwd".to_owned(),
        "../policy.safetensors".to_owned(),
    ] {
        let mut body = run_request(&json!({}));
        body["controllers"] = json!([name]);
        let (status, answer) = post("run", body.to_string().as_bytes());
        assert_eq!(
            (status, &answer["error"]["field"]),
            (422, &json!("controllers[0]")),
            "{name}"
        );
    }
    let mut body = run_request(&json!({}));
    body["scenario"]["vehicles"][2]["driver"] = json!({ "file": { "path": "/etc/passwd" } });
    for (what, body) in [
        ("avoid", json!({ "scenario": body["scenario"] })),
        (
            "save",
            json!({ "edited": { "scenario": body["scenario"] }, "controller": "idm" }),
        ),
        ("run", body),
    ] {
        let (status, answer) = post(what, body.to_string().as_bytes());
        let field = json!("scenario.vehicles[2].driver.file.path");
        assert_eq!(
            (status, &answer["error"]["field"]),
            (422, &field),
            "{answer}"
        );
    }
    assert!(!collided.exists());
}

#[test]
fn an_edited_scenario_has_the_same_collision_in_its_saved_file() {
    let edits = json!({
        "name": "dragged",
        "friction": 0.75,
        "vehicles": [
            { "vehicle": 1, "gap_m": 11.3, "class": "heavy" },
            { "vehicle": 2, "gap_m": 9.77, "speed_mps": 26.1 },
        ],
        "lead": { "from_s": [0.0, 1.5, 4.25], "accel_mps2": [0.0, -4.5, -1.0] },
    });
    let (status, response) = post("run", run_request(&edits).to_string().as_bytes());
    assert_eq!(status, 200, "{response}");
    assert_eq!(
        response["sliders"]["vehicles"][2]["gap_m"]
            .as_f64()
            .map(|gap| (gap * 1e6).round() / 1e6),
        Some(9.77)
    );
    let save = json!({
        "edited": { "scenario": built_in_scenario("paper-1").unwrap().spec(), "edits": edits },
        "controller": "baseline",
        "estimator": "truth",
    });
    let (status, saved) = post("save", save.to_string().as_bytes());
    assert_eq!(status, 200, "{saved}");
    assert_eq!(saved["file_name"], "dragged.toml");
    let scenario = file::from_toml(
        saved["toml"].as_str().unwrap(),
        Path::new("dragged.toml"),
        &NoDriverFiles,
    )
    .unwrap();
    let baseline = BuiltInController::from_name("baseline").unwrap();
    let options = RunOptions::new(baseline).with_estimator(EstimatorKind::Truth);
    let again = simulate(
        &Run::new(&scenario, options).unwrap(),
        RecordingLevel::Trace,
    );
    let collision_s = again
        .outcome
        .collision()
        .expect("hard braking on a wet road")
        .time_s;
    assert_eq!(
        response["runs"][0]["collision_time_s"].as_f64(),
        Some(collision_s)
    );
    assert!(
        saved["command"]
            .as_str()
            .unwrap()
            .contains("--controller baseline --estimator truth"),
        "{saved}"
    );
}

#[test]
fn an_avoidable_collision_is_answered_with_an_escape() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let body = json!({ "scenario": scenario.spec() });
    let (status, answer) = post("avoid", body.to_string().as_bytes());
    assert_eq!(
        (status, &answer["verdict"]),
        (200, &json!("avoidable")),
        "{answer}"
    );
    let shown: Vec<String> = serde_json::from_value(answer["statements"].clone()).unwrap();
    let avoidance = avoid(&scenario, AvoidOptions::default()).unwrap();
    let printed = AvoidReport::new(&scenario, &avoidance).to_text();
    let (note, statements) = shown.split_last().unwrap();
    assert_eq!(
        note,
        "a driver with knowledge of the future can drive like this escape"
    );
    assert!(statements.len() > 3, "{shown:?}");
    for statement in statements {
        assert!(printed.contains(statement), "{statement}\n{printed}");
    }
    // A script drives the ego vehicle of an escape, which is still named so.
    let figure = answer["escape_figure"].as_str().unwrap();
    let texts = [
        "ego (light)",
        "follower (heavy, baseline)",
        "Acceleration",
        "Time to collision",
    ];
    for text in texts {
        assert!(figure.contains(text), "{text}");
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(96))]
    /// A request with any damage gets a response, and one clear error if it is invalid.
    #[test]
    fn damaged_requests_are_refused_with_one_clear_error(
        at in 0.0..1.0_f64,
        put in prop::collection::vec(any::<u8>(), 0..6),
        cut in 0..9_usize,
    ) {
        let edits = json!({ "friction": 0.9, "vehicles": [{ "vehicle": 1, "gap_m": 30.0 }] });
        let whole = run_request(&edits).to_string().into_bytes();
        let end = (at * whole.len() as f64) as usize;
        let damaged = [&whole[..end], &put, whole.get(end + cut..).unwrap_or_default()].concat();
        let (status, answer) = post("run", &damaged);
        prop_assert!(status == 200 || (400..500).contains(&status), "{status}: {answer}");
        let message = answer["error"]["message"].as_str().unwrap_or_default();
        prop_assert!((status == 200) == message.is_empty() && message.lines().count() <= 1, "{status}: {answer}");
    }

    /// Bytes that are no request may get no response, but the next request does.
    #[test]
    fn malformed_requests_do_not_stop_the_server(bytes in prop::collection::vec(any::<u8>(), 1..200)) {
        let sent = [&bytes[..], b"\r\n\r\n"].concat();
        let mut stream = TcpStream::connect(("127.0.0.1", test_server().port)).unwrap();
        // The server may have closed the connection already.
        let _ = stream.write_all(&sent).and_then(|()| stream.shutdown(Shutdown::Write));
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let status = String::from_utf8_lossy(&answer).split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
        prop_assert!(status == 0 || (400..500).contains(&status), "{status}");
        prop_assert_eq!(post("open", br#"{"scenario": 0}"#).0, 200);
    }
}
