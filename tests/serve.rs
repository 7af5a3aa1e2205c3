//! The label room for browsers, asked over the network as a page asks it, and as nobody should.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Program, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use dropj::app::{App, Command, Effect, FirstWorld, LabelCommand, Moment, Startup, Tick};
use dropj::dream::{Dream, DreamEpisode};
use dropj::query::{
    DreamId, Preference, Protocol, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SegmentRef, SkipReason,
    Strategy,
};
use dropj::serve::{Rate, ServeConfig, ServeError, Server, TOKENS_FILE, draw};
use dropj::session::{
    Annotators, Answer, DreamSource, Event, Header, Session, SessionError, SessionStore, hand_out, merge,
};
use dropj::worker::{JobCommand, LoadedWorld, Report, SessionWriter, WorkerCommand, jobs};
use dropj::world::Action;
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// A world model that has learned nothing: what is dreamt does not matter here.
fn model() -> WorldModel {
    tch::set_num_threads(1);
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0))
}

fn dream(seed: u64) -> DreamEpisode {
    let (model, rng) = (model(), &mut ChaCha8Rng::seed_from_u64(seed));
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let mut dream = Dream::new(&start, seed);
    for t in 0..90 {
        let action = Action::new([(t as f32).sin(), 0.5, 0.0]);
        dream.step(&model, action, rng).expect("it goes on");
    }
    dream.finish()
}

/// A session called `s` in `dir`, with two dreams and so many queries.
fn session(dir: &Path, n_queries: usize, protocol: Protocol) -> PathBuf {
    let path = dir.join("s");
    let header = Header::new("car-racing", protocol, 3, &model().hash(), 1_795_342_500_000);
    let mut store = SessionStore::create(&path, header).expect("there is room");
    store.save_world_model(&model()).expect("there is room");
    for seed in 1..=2 {
        store.save_dream(&dream(seed), DreamSource::User).expect("there is room");
    }
    if n_queries > 0 {
        draw(&mut store, n_queries, Strategy::Uniform).expect("dreams are long enough");
    }
    path
}

/// A server in a thread of its own, until it is dropped.
struct Served {
    at: SocketAddr,
    tokens: Vec<String>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), ServeError>>>,
}

impl Served {
    fn new(config: &ServeConfig) -> Self {
        let server = Server::open(config, &model()).expect("it can be offered");
        let token =
            |link: &str| link.split_once('#').map(|(_, token)| token.to_owned()).expect("a link has one");
        let tokens = server.standings().iter().map(|standing| token(&standing.link)).collect();
        let (at, stop) = (server.at(), Arc::new(AtomicBool::new(false)));
        let until = Arc::clone(&stop);
        let named = std::thread::Builder::new().name("server".to_owned());
        let thread = named.spawn(move || server.run(&until)).ok();
        Self { at, tokens, stop, thread }
    }

    /// Sends these bytes and reads what is answered: the status, the head, and the body.
    fn send(&self, bytes: &[u8]) -> (u16, String, Vec<u8>) {
        send(self.at, bytes)
    }

    fn get(&self, path: &str, token: &str) -> (u16, Value) {
        let (status, _, body) = self.send(request(self.at, "GET", path, token, "").as_bytes());
        (status, serde_json::from_slice(&body).unwrap_or_default())
    }

    /// Says something as the annotator of this number.
    fn act(&self, who: usize, nr: usize, act: &Value) -> (u16, Value) {
        act_at(self.at, &self.tokens[who], nr, act)
    }

    fn view(&self, who: usize) -> Value {
        let (status, view) = self.get("/api/view", &self.tokens[who]);
        assert_eq!(status, 200, "{view}");
        view
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(
            matches!(ended, Some(Ok(Ok(())))) || std::thread::panicking(),
            "it ends in good order: {ended:?}"
        );
    }
}

fn request(at: SocketAddr, method: &str, path: &str, token: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "{method} {path} HTTP/1.1\r\nHost: {at}\r\nAuthorization: Bearer {token}\r\nContent-Length: {length}\r\n\r\n{body}"
    )
}

fn send(at: SocketAddr, bytes: &[u8]) -> (u16, String, Vec<u8>) {
    let mut stream = TcpStream::connect(at).expect("it listens");
    stream.set_read_timeout(Some(Duration::from_mins(1))).expect("it can wait");
    // What is refused may be refused before it is sent to its end.
    stream.write_all(bytes).ok();
    receive(&mut stream)
}

fn receive(stream: &mut TcpStream) -> (u16, String, Vec<u8>) {
    let mut read = Vec::new();
    stream.read_to_end(&mut read).ok();
    let end = read.windows(4).position(|four| four == b"\r\n\r\n").map_or(read.len(), |at| at + 4);
    let body = read.split_off(end);
    let head = String::from_utf8(read).expect("a head is text");
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or_default();
    (status, head, body)
}

fn act_at(at: SocketAddr, token: &str, nr: usize, act: &Value) -> (u16, Value) {
    let body = json!({"nr": nr, "act": act}).to_string();
    let (status, _, body) = send(at, request(at, "POST", "/api/act", token, &body).as_bytes());
    (status, serde_json::from_slice(&body).unwrap_or_default())
}

fn answer(query: u64, response: &Value, secs: f64) -> Value {
    json!({"answer": {"query": query, "response": response, "secs": secs, "loops": 2}})
}

/// What annotators said, as it stands in the log.
fn said(dir: &Path) -> Vec<Event> {
    let store = SessionStore::open(dir, None).expect("it is whole");
    let is_said = |event: &Event| {
        !matches!(event, Event::DreamKept(_) | Event::Asked { .. } | Event::AskedTransition { .. })
    };
    store.entries().iter().map(|entry| entry.event.clone()).filter(is_said).collect()
}

#[test]
fn without_a_token_nothing_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 5, Protocol::Dropj);
    let served = Served::new(&ServeConfig::new(&session, &["anna", "ben"]));
    let [mine, other] = [served.tokens[0].clone(), served.tokens[1].clone()];
    assert!(mine.len() == 32 && mine != other, "each has one of their own");
    let nearly = format!("{}x", &mine[..31]);
    for token in ["", "x", &nearly, &mine.to_uppercase(), &format!("{mine}0")] {
        for (method, path) in
            [("GET", "/api/view"), ("GET", "/api/clip/0/left"), ("POST", "/api/act"), ("GET", "/api/else")]
        {
            let (status, head, body) = served.send(request(served.at, method, path, token, "{}").as_bytes());
            let told = String::from_utf8(body).unwrap();
            assert_eq!(status, 401, "{method} {path} with {token:?}: {told}");
            for word in ["anna", "ben", "dropj", "asked", "session"] {
                assert!(!told.contains(word) && !head.contains(word), "{told} tells of {word}");
            }
        }
    }
    let without = format!("GET /api/view HTTP/1.1\r\nHost: {}\r\n\r\n", served.at);
    assert_eq!(served.send(without.as_bytes()).0, 401);

    let (status, head, body) = served.send(without.replace("/api/view", "/").as_bytes());
    let page = String::from_utf8(body).unwrap();
    assert_eq!(status, 200);
    assert!(
        !page.contains("anna") && !page.contains("http://") && !page.contains("{{"),
        "it tells nothing, loads nothing"
    );
    let nonce = head.split("script-src 'nonce-").nth(1).and_then(|rest| rest.split('\'').next()).unwrap();
    assert!(page.contains(&format!("<script nonce=\"{nonce}\">")) && nonce.len() == 32, "{head}");
    assert!(!head.contains("Access-Control"), "no other page may ask: {head}");
    let again = served.send(without.replace("/api/view", "/").as_bytes()).1;
    assert!(!again.contains(nonce), "another page has another");

    // A name that was made to lead here, and a page from elsewhere.
    let asked = request(served.at, "GET", "/api/view", &mine, "");
    let port = served.at.port();
    let renamed = asked.replace(&format!("Host: {}", served.at), &format!("Host: evil.example:{port}"));
    assert_eq!(served.send(renamed.as_bytes()).0, 403);
    let foreign = asked.replace("\r\n\r\n", "\r\nOrigin: http://evil.example\r\n\r\n");
    assert_eq!(served.send(foreign.as_bytes()).0, 403);
    let own = asked.replace(&format!("Host: {}", served.at), &format!("Host: localhost:{port}"));
    let own = own.replace("\r\n\r\n", &format!("\r\nOrigin: http://localhost:{port}\r\n\r\n"));
    assert_eq!(served.send(own.as_bytes()).0, 200);
}

/// The application as a window drives it, with what it writes written at once.
struct Window {
    app: App,
    writer: SessionWriter,
    nr: u64,
}

impl Window {
    fn new(store: SessionStore) -> Self {
        let model = model();
        let world = LoadedWorld {
            name: model.hash(),
            path: None,
            parameters: model.parameters().clone(),
            card: Vec::new(),
            starts: Vec::new(),
            compact: None,
        };
        let app = App::new(Startup {
            spec: Arc::clone(model.spec()),
            spec_file: None,
            sessions: PathBuf::new(),
            dataset: PathBuf::new(),
            seed: 3,
            world: FirstWorld::Here(Ok(Box::new(world))),
            session: Some(store),
        });
        let mut window = Self { app, writer: SessionWriter::default(), nr: 0 };
        window.settle();
        window
    }

    fn command(&mut self, command: LabelCommand) {
        self.nr += 1;
        let moment = Moment { nr: self.nr, at: self.nr as f64 };
        self.app.tick(Tick { moment, dt: 1.0, date: 1_795_342_500_000, has_focus: true, is_touched: true });
        self.app.command(Command::Label(command), moment);
        self.settle();
    }

    fn settle(&mut self) {
        loop {
            let effects = self.app.take_effects();
            if effects.is_empty() {
                return;
            }
            let mut reports = Vec::new();
            for effect in effects {
                match effect {
                    Effect::Worker(WorkerCommand::SessionWriter(command)) => {
                        self.writer.handle(command, &mut |report| reports.push(Report::Session(report)));
                    }
                    Effect::Worker(WorkerCommand::Jobs(command @ JobCommand::ReadSession(_))) => {
                        let load: dropj::worker::LoadWorldModel = Arc::new(|path| unreachable!("{path:?}"));
                        jobs::run(command, &load, &mut |report| reports.push(Report::Job(report)));
                    }
                    _ => {}
                }
            }
            for report in reports {
                self.app.report(report);
            }
        }
    }
}

#[test]
fn twenty_answers_are_acknowledged_on_disk_and_stand_there_as_the_window_writes_them() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 24, Protocol::Dropj);
    let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
    let responses = [
        Response::Safety(SafetyAnswer::OnlyLeft),
        Response::Safety(SafetyAnswer::OnlyRight),
        Response::Safety(SafetyAnswer::Neither),
        both(Preference::Left),
        both(Preference::Equal),
        both(Preference::Right),
        Response::Skipped(None),
    ];
    let own = hand_out(&session, &dir.path().join("window"), "anna").unwrap();
    let mut window = Window::new(own);
    let served = Served::new(&ServeConfig::new(&session, &["anna"]));
    let folder = dir.path().join("s-anna");
    let log = || std::fs::read_to_string(folder.join("events.jsonl")).unwrap().lines().count();
    let (mut n_lines, mut nr) = (log(), 0);
    let mut say = |act: &Value| {
        let (status, view) = served.act(0, nr, act);
        assert_eq!(status, 200, "{act}: {view}");
        (nr, n_lines) = (nr + 1, n_lines + 1);
        assert_eq!(
            (view["nr"].as_u64(), log()),
            (Some(nr as u64), n_lines),
            "it is acknowledged when it is there"
        );
        view
    };
    for n in 0..20u32 {
        let (query, response) = (QueryId(n), responses[n as usize % responses.len()]);
        let view = say(&answer(u64::from(n), &serde_json::to_value(response).unwrap(), 0.0));
        window.command(LabelCommand::AnswerFor { query, response, annotator: "anna".to_owned() });
        if response == Response::Skipped(None) {
            assert_eq!(view["skipped"], json!(n), "it may be given a reason");
            say(&json!({"explain": {"query": n, "reason": "hallucinated"}}));
            window.command(LabelCommand::ExplainSkip(SkipReason::Hallucinated));
        } else {
            assert!(view["said"].as_str().unwrap().starts_with("μ = "), "{view}");
        }
        if n == 9 {
            let view = say(&json!({"undo": {"query": 9}}));
            assert_eq!(
                (&view["next"][0]["query"], &view["redo"]),
                (&json!(9), &json!(9)),
                "it is asked again"
            );
            window.command(LabelCommand::Undo);
            say(&json!({"redo": {"query": 9}}));
            window.command(LabelCommand::Redo);
        }
    }
    let view = served.view(0);
    assert_eq!(
        (&view["n_done"], &view["n_all"], &view["next"][0]["query"]),
        (&json!(20), &json!(24), &json!(20))
    );
    drop((served, window));
    let here: Vec<_> = said(&folder)
        .into_iter()
        .map(|event| match event {
            // A script that drives the window looks at nothing.
            Event::Answered(answer) => Event::Answered(Answer { loops: 0, ..answer }),
            event => event,
        })
        .collect();
    assert_eq!(here, said(&dir.path().join("window")), "the same things happened");
    let log = std::fs::read_to_string(folder.join("events.jsonl")).unwrap();
    assert!(
        log.contains(r#""response":{"safety":{"both":"left"}},"secs":0.0,"loops":2,"annotator":"anna""#),
        "{log}"
    );
}

#[test]
fn what_is_sent_twice_counts_once_even_by_a_server_that_was_begun_anew() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 6, Protocol::Drop);
    let config = ServeConfig::new(&session, &["anna"]);
    let (left, right) = (json!({"preferred": "left"}), json!({"preferred": "right"}));
    let first = Served::new(&config);
    let (at, token) = (first.at, first.tokens[0].clone());
    assert_eq!(first.act(0, 0, &answer(0, &left, 1.5)).0, 200);
    assert_eq!(first.act(0, 0, &answer(0, &left, 1.5)).0, 200, "its acknowledgement was lost");
    assert_eq!(first.act(0, 1, &json!({"undo": {"query": 0}})).0, 200);
    assert_eq!(first.act(0, 1, &json!({"undo": {"query": 0}})).0, 200);
    assert_eq!(first.act(0, 2, &answer(0, &right, 2.25)).0, 200);
    drop(first);

    // More is asked by then, and the link is the same.
    draw(&mut SessionStore::open(&session, None).unwrap(), 8, Strategy::Uniform).unwrap();
    let second = Served::new(&config);
    assert_eq!((second.at, &second.tokens[0]), (at, &token), "links last");
    assert_eq!(
        second.act(0, 2, &answer(0, &right, 2.25)).0,
        200,
        "this server knows what the other one wrote"
    );
    assert_eq!(second.view(0)["n_all"], 8);
    // Another screen of the same person says something else meanwhile.
    assert_eq!(second.act(0, 3, &answer(1, &left, 0.5)).0, 200);
    let (status, told) = second.act(0, 3, &answer(2, &right, 0.75));
    assert_eq!((status, &told["nr"]), (409, &json!(4)), "{told}");
    assert_eq!(second.act(0, 4, &answer(2, &right, 0.75)).0, 200);
    assert_eq!(second.act(0, 3, &answer(2, &right, 0.75)).0, 200, "it stands further on");
    assert_eq!(second.act(0, 9, &answer(3, &right, 0.75)).0, 409, "nobody said so much");
    drop(second);
    let answered = |query, preference, secs| {
        let answer = Answer::new(QueryId(query), Response::Preferred(preference), secs, "anna");
        Event::Answered(Answer { loops: 2, ..answer })
    };
    let expected = [
        answered(0, Preference::Left, 1.5),
        Event::Retracted { query: QueryId(0) },
        answered(0, Preference::Right, 2.25),
        answered(1, Preference::Left, 0.5),
        answered(2, Preference::Right, 0.75),
    ];
    assert_eq!(said(&dir.path().join("s-anna")), expected);
}

#[test]
fn what_is_malformed_too_large_or_impossible_is_refused_in_a_sentence_and_nothing_else_happens() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 3, Protocol::Dropj);
    let served = Served::new(&ServeConfig::new(&session, &["anna"]));
    let token = &served.tokens[0];
    let head = |more: &str| format!("POST /api/act HTTP/1.1\r\nHost: {}\r\n{more}\r\n", served.at);
    let long = "x".repeat(9000);
    for (bytes, expected) in [
        ("nonsense\r\n\r\n".to_owned(), 400),
        ("\u{16}\u{3}\u{1}".repeat(20), 400),
        ("GET / HTTP/1.1\r\n\r\n".to_owned(), 400),
        (format!("GET /{long} HTTP/1.1\r\nHost: x\r\n\r\n"), 431),
        (head(&format!("X: {long}\r\n")), 431),
        (head("Content-Length: 5000\r\n") + &long[..5000], 413),
        (head("Content-Length: 99999999999999999999999\r\n"), 413),
        (head("Transfer-Encoding: chunked\r\n") + "5\r\nhello\r\n0\r\n\r\n", 411),
        (head("").replace("POST", "PUT"), 405),
        (request(served.at, "POST", "/", token, ""), 405),
        (request(served.at, "POST", "/api/view", token, ""), 405),
        (request(served.at, "GET", "/api/act", token, ""), 405),
        (request(served.at, "GET", "/../../etc/passwd", token, ""), 404),
        (request(served.at, "GET", "/api/clip/9/left", token, ""), 404),
        (request(served.at, "GET", "/api/clip/0/middle", token, ""), 404),
        (request(served.at, "GET", "/api/clip/-1/left", token, ""), 404),
    ] {
        let (status, _, body) = served.send(bytes.as_bytes());
        let told: Value = serde_json::from_slice(&body).unwrap_or_default();
        let shown: String = bytes.chars().take(60).collect();
        assert_eq!(status, expected, "{shown:?}: {told}");
        assert!(told["error"].as_str().is_some_and(|why| why.len() > 10), "{shown:?}: {told}");
    }
    let only_left = json!({"safety": "only_left"});
    for (act, expected) in [
        (json!({"answer": {"query": 0}}), 400),
        (json!({"answer": {"query": 0, "response": only_left, "secs": 1e99, "loops": 0}}), 422),
        (json!({"answer": {"query": 0, "response": only_left, "secs": 1, "loops": 0, "more": 1}}), 400),
        (answer(0, &json!({"preferred": "left"}), 1.0), 422),
        (answer(0, &only_left, -1.0), 422),
        (answer(7, &only_left, 1.0), 422),
        (json!({"undo": {"query": 0}}), 422),
        (json!({"explain": {"query": 0, "reason": "other"}}), 422),
        (json!({"weights": {}}), 400),
        (json!(null), 400),
    ] {
        let (status, told) = served.act(0, 0, &act);
        assert_eq!(status, expected, "{act}: {told}");
    }
    assert_eq!(served.view(0)["nr"], 0);
    drop(served);
    assert_eq!(said(&dir.path().join("s-anna")), []);
}

#[test]
fn whoever_is_slow_or_asks_too_often_waits_for_nobody_and_keeps_nobody() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 3, Protocol::Dropj);
    let mut config = ServeConfig::new(&session, &["anna", "ben"]);
    config.patience.request = Duration::from_millis(700);
    config.rates.token = Rate { burst: 4.0, per_sec: 0.001 };
    let served = Served::new(&config);
    // So many that say nothing to its end are all that one address has.
    let mut slow: Vec<_> = (0..24).map(|_| TcpStream::connect(served.at).unwrap()).collect();
    for stream in &mut slow {
        stream.write_all(b"GET /api/view HTTP/1.1\r\nHo").unwrap();
    }
    let (status, _, body) = served.send(format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", served.at).as_bytes());
    // They may have been sent away already, on a machine that is busy.
    assert!(matches!(status, 503 | 200), "{status}: {}", String::from_utf8_lossy(&body));
    for stream in &mut slow {
        let (status, _, body) = receive(stream);
        assert_eq!(status, 408, "{}", String::from_utf8_lossy(&body));
    }
    drop(slow);
    // One that comes and goes without a word, and one that ends in the middle.
    drop(TcpStream::connect(served.at).unwrap());
    let mut half = TcpStream::connect(served.at).unwrap();
    half.write_all(b"POST /api/act HTTP/1.1\r\nContent-Length: 9\r\n\r\n123").unwrap();
    half.shutdown(Shutdown::Write).unwrap();
    assert_eq!(receive(&mut half).0, 400);

    let statuses: Vec<_> = (0..6).map(|_| served.get("/api/view", &served.tokens[0]).0).collect();
    assert_eq!(statuses, [200, 200, 200, 200, 429, 429]);
    assert_eq!(served.get("/api/view", &served.tokens[1]).0, 200, "others are served");
}

#[test]
fn a_clip_is_what_the_window_shows_twenty_pictures_one_below_the_other() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 4, Protocol::Dropj);
    let served = Served::new(&ServeConfig::new(&session, &["anna"]));
    let asked = SessionStore::read(&session).unwrap().1;
    for (query, side) in [(0, "left"), (0, "right"), (3, "right"), (0, "left")] {
        let path = format!("/api/clip/{query}/{side}");
        let (status, head, body) =
            served.send(request(served.at, "GET", &path, &served.tokens[0], "").as_bytes());
        assert!(status == 200 && head.contains("image/png") && head.contains("no-store"), "{head}");
        let strip = image::load_from_memory(&body).unwrap().to_rgb8();
        let shown = asked.queries()[query].query;
        let SegmentRef { dream: id, start } = if side == "left" { shown.left } else { shown.right };
        let frames = dream(u64::from(id.0) + 1).frames(&model(), start..start + SEGMENT_LEN);
        let expected: Vec<u8> = frames.iter().flat_map(|frame| frame.rgb().to_vec()).collect();
        assert_eq!(strip.dimensions(), (20, 400));
        let apart = strip.as_raw().iter().zip(&expected).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(apart <= Some(2), "a batch rounds differently, but little: {apart:?}");
    }
}

#[test]
fn transitions_are_judged_in_their_order() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 5, Protocol::Dros);
    let served = Served::new(&ServeConfig::new(&session, &["anna"]));
    let view = served.view(0);
    let place = |nr: usize| view["next"][nr]["place"].as_u64();
    assert_eq!((place(0), place(4)), (Some(1), Some(5)), "{view}");
    let (from, to) = (view["next"][0]["span"][0].as_u64(), view["next"][0]["span"][1].as_u64());
    assert_eq!(view["next"][0]["outcome"].as_u64().map(|outcome| outcome + 1), to);
    assert!(from < to && view["verdicts"][1] == "Neither", "{view}");
    assert_eq!(served.act(0, 0, &answer(0, &json!({"judged": "good"}), 1.0)).0, 200);
    assert_eq!(served.act(0, 1, &answer(1, &json!({"safety": "neither"}), 1.0)).0, 422);
    drop(served);
    assert_eq!(SessionStore::read(&dir.path().join("s-anna")).unwrap().1.judged().len(), 1);
}

#[test]
fn what_several_said_is_compared_and_put_together() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 6, Protocol::Dropj);
    let served = Served::new(&ServeConfig::new(&session, &["anna", "ben"]));
    for (query, said) in ["only_left", "only_right", "neither", "only_left"].into_iter().enumerate() {
        let other = if query == 3 { "only_right" } else { said };
        for (who, said) in [(0, said), (1, other)] {
            let (status, told) = served.act(who, query, &answer(query as u64, &json!({"safety": said}), 2.0));
            assert_eq!(status, 200, "{told}");
        }
    }
    drop(served);
    let dirs = ["s-anna", "s-ben"].map(|name| dir.path().join(name));
    let read: Vec<Session> = dirs.iter().map(|dir| SessionStore::read(dir).unwrap().1).collect();
    let found = Annotators::of_sessions(&[("a".to_owned(), &read[0]), ("b".to_owned(), &read[1])]);
    let [(names, agreement)] = &found.pairs[..] else { panic!("{found:?}") };
    assert_eq!((names.join(" "), agreement.n, agreement.n_same), ("anna ben".to_owned(), 4, 3));
    let merged = merge(&dirs, &dir.path().join("both")).unwrap();
    assert_eq!((merged.session().labeled().len(), merged.session().dreams().len()), (8, 2));
    assert_eq!(
        SessionStore::read(&session).unwrap().1.answers().len(),
        0,
        "what was offered stays as it was"
    );
}

#[test]
fn what_cannot_be_offered_is_one_clear_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), 0, Protocol::Dropj);
    let refused = |config: &ServeConfig| Server::open(config, &model()).unwrap_err();
    let config = ServeConfig::new(&path, &["anna"]);
    let error = refused(&config);
    assert!(
        matches!(error, ServeError::NoQueries { .. }) && error.to_string().contains("--queries"),
        "{error}"
    );
    let error = refused(&ServeConfig::new(&path, &[]));
    assert!(matches!(error, ServeError::Nobody), "{error}");
    let error = refused(&ServeConfig::new(&path, &["a b", "a-b"]));
    assert!(matches!(error, ServeError::SameFolder { .. }), "{error}");

    let drawing = ServeConfig { n_queries: Some(7), ..config.clone() };
    let open = SessionStore::open(&path, None).unwrap();
    let in_use = |error: ServeError| {
        let is_it = matches!(error, ServeError::Session(SessionError::InUse { .. }));
        assert!(is_it && error.to_string().contains("another program has it open"), "{error}");
    };
    in_use(refused(&drawing));
    drop(open);
    let server = Server::open(&drawing, &model()).unwrap();
    assert_eq!((server.n_drawn(), server.standings()[0].n_all), (7, 7));
    in_use(refused(&config));
    drop(server);
    let open = SessionStore::open(&path, None).unwrap();
    let server = Server::open(&config, &model()).unwrap();
    let taken = ServeConfig { annotators: vec!["ben".to_owned()], ..config.clone() };
    let error = refused(&taken);
    assert!(matches!(error, ServeError::Listen { .. }) && error.to_string().contains("--port"), "{error}");
    drop((open, server));
    std::fs::write(path.join(TOKENS_FILE), "[tokens]\nanna = \"short\"\n").unwrap();
    let error = refused(&config);
    assert!(matches!(error, ServeError::Tokens { .. }), "{error}");
    let damaged = dir.path().join("s-anna/dreams/0000.safetensors");
    std::fs::remove_file(path.join(TOKENS_FILE)).unwrap();
    std::fs::write(&damaged, "no dream").unwrap();
    let server = Server::open(&config, &model()).unwrap();
    assert!(server.standings()[0].n_all < 7, "nothing is asked about a dream that cannot be read");
    assert_eq!(DreamId(0), SessionStore::read(&path).unwrap().1.dreams()[0].dream);
}

#[cfg(unix)]
#[test]
fn tokens_are_read_by_nobody_else_on_this_machine() {
    use std::os::unix::fs::PermissionsExt as _;

    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), 3, Protocol::Dropj);
    drop(Server::open(&ServeConfig::new(&session, &["anna"]), &model()).unwrap());
    let mode = std::fs::metadata(session.join(TOKENS_FILE)).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
}

/// The program itself, as it is started on the command line.
struct Running {
    child: Child,
    at: SocketAddr,
    token: String,
}

impl Running {
    fn start(dir: &Path) -> Self {
        let mut program = Program::new(env!("CARGO_BIN_EXE_dropj"));
        let args = ["serve", "--session", "s", "--annotators", "anna", "--json"];
        let mut child = program
            .current_dir(dir)
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("it starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("it is read");
        BufReader::new(out).read_line(&mut line).expect("it says where it is");
        let told: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"));
        let link = told["link"].as_str().expect("a link").trim_start_matches("http://");
        let (host, token) = link.split_once("/#").expect("a link has a token");
        Self { child, at: host.parse().expect("an address"), token: token.to_owned() }
    }
}

#[test]
fn a_program_that_is_killed_loses_nothing_that_it_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    session(dir.path(), 60, Protocol::Drop);
    let (mut n_acknowledged, mut n_sent) = (0, 0);
    for round in 0..3 {
        let mut running = Running::start(dir.path());
        let (at, token) = (running.at, running.token.clone());
        let one_more = |nr: usize| {
            let side = if nr.is_multiple_of(2) { "left" } else { "right" };
            act_at(at, &token, nr, &answer(nr as u64, &json!({"preferred": side}), nr as f64))
        };
        // The last one was sent, and nobody knows whether it arrived.
        for nr in n_acknowledged..n_acknowledged + 5 {
            assert_eq!(one_more(nr).0, 200);
        }
        n_acknowledged += 5;
        let body = json!({"nr": n_acknowledged, "act": answer(n_acknowledged as u64, &json!({"preferred": "left"}), 0.5)});
        let mut stream = TcpStream::connect(at).unwrap();
        stream.write_all(request(at, "POST", "/api/act", &token, &body.to_string()).as_bytes()).unwrap();
        n_sent = n_acknowledged + 1;
        std::thread::sleep(Duration::from_millis(round));
        running.child.kill().unwrap();
        running.child.wait().unwrap();
        let there = said(&dir.path().join("s-anna"));
        assert!((n_acknowledged..=n_sent).contains(&there.len()), "{} of {n_acknowledged}", there.len());
        n_acknowledged = there.len();
    }
    let there = said(&dir.path().join("s-anna"));
    let queries: Vec<_> = there
        .iter()
        .map(|event| match event {
            Event::Answered(answer) => answer.query.0 as usize,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(queries, (0..there.len()).collect::<Vec<_>>(), "each once, and in order, of {n_sent}");
}
