//! The label room for browsers: several people answer the queries of a session, each in a session of their own.
//!
//! Every annotator has a token and, beside the session that is offered, a session with the same dreams and queries
//! ([`hand_out()`](crate::session::hand_out())); what they say goes into its log as from the window, and `agree` and `merge`
//! take it from there. A page (`page/page.js`) shows what is next, plays the clips and keeps what was said until it is
//! acknowledged, through a server that is away and through its own end.
//!
//! # What is spoken
//!
//! HTTP/1.1, one request a connection. The page itself relies on this and comes from the same program; whoever writes a client
//! of their own may as well, for as long as the number below stays.
//!
//! | request | answer |
//! |---|---|
//! | `GET /` | the page; all that it needs is in it |
//! | `GET /api/view` | what is asked next, what was said last, how far it is |
//! | `GET /api/clip/QUERY/left`, `…/right` | a clip: 20 pictures one below the other, as PNG |
//! | `POST /api/act` | takes in what is said: `{"nr": NUMBER, "act": ACT}`; answers as `view` does, once it is on disk |
//!
//! All but the page wants `Authorization: Bearer TOKEN`. An act is one of
//! `{"answer": {"query", "response", "secs", "loops"}}`, `{"explain": {"query", "reason"}}` and `undo`, `redo`, `flag` and
//! `unflag` with a `query`; responses and reasons are those of the log (`assets/format-sessions.md`). Its number says how much had
//! been said before it, so that it counts once however often it is sent.
//! What is refused is answered with a status and `{"error": SENTENCE}`: 400 it cannot be read, 401 no token, 403 another
//! name or page, 404 no such thing, 408 too slow, 409 another number is next, which stands beside it as `nr`, 413 too large, 422
//! it cannot be said of this query, 429 too often, 503 it cannot be written down or nobody has time: it is to be sent again.
//!
//! # Limits
//!
//! A request has five seconds, 8 KiB of head and 4 KiB of body; an address 24 connections at once; addresses and tokens so
//! many requests a second ([`Rates`]). One thread for each of 32 connections; what comes beyond waits, and is then sent
//! away. The head is read by `httparse`, hyper's parser; the rest is here, for `tiny_http` waits for slow clients
//! without end, and what waits better brings an asynchronous runtime for a handful of people.

mod clips;
mod desk;
mod draw;
mod error;
mod http;
mod limits;
mod room;
mod tokens;

use std::collections::{BTreeMap, HashMap};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand::rngs::SysRng;
use rand_chacha::ChaCha20Rng;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::query::{DreamId, Strategy};
use crate::session::{SessionStore, annotator_folder, hand_out};
use crate::worker::Crew;
use crate::world_model::WorldModel;

pub use draw::draw;
pub use error::ServeError;
pub use http::Patience;
pub use limits::{Rate, Rates};
pub use tokens::TOKENS_FILE;

use clips::Clips;
use desk::Desk;
use http::{Refused, Response};
use room::{Room, read_dreams};
use tokens::{Doorkeeper, Tokens};

/// Connections that are answered at once.
const N_HANDS: usize = 32;
/// Connections that wait for one of them.
const N_WAITING: usize = 64;
/// Connections of one address at once: browsers open six, and several people can come through one tunnel.
const N_OF_ONE: usize = 24;
/// How often it looks whether it is to end.
const LOOK_EVERY: Timespec = Timespec { tv_sec: 0, tv_nsec: 200_000_000 };
/// What is read of a request that is refused, before the connection ends.
const DRAIN: Duration = Duration::from_millis(300);
/// The same where everybody else waits for it.
const HURRY: Duration = Duration::from_millis(10);

/// What is offered, to whom, and where.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// The session whose queries are offered.
    pub session: PathBuf,
    /// The folder of the annotators' sessions; without it they lie beside the one that is offered.
    pub out: Option<PathBuf>,
    /// Who answers.
    pub annotators: Vec<String>,
    /// How many queries there are to be at least; those that are missing are drawn into the session.
    pub n_queries: Option<usize>,
    /// How they are drawn.
    pub strategy: Strategy,
    /// The file of the tokens; without it that in the session's folder.
    pub tokens: Option<PathBuf>,
    /// Where it listens.
    pub address: IpAddr,
    /// The port, 0 being any that is free; without one that of last time.
    pub port: Option<u16>,
    /// What clients may take their time for.
    pub patience: Patience,
    /// How often they may ask.
    pub rates: Rates,
}

impl ServeConfig {
    /// The queries that are there, for this machine alone.
    pub fn new(session: &Path, annotators: &[&str]) -> Self {
        Self {
            session: session.to_owned(),
            out: None,
            annotators: annotators.iter().map(|name| (*name).to_owned()).collect(),
            n_queries: None,
            strategy: Strategy::Uniform,
            tokens: None,
            address: Ipv4Addr::LOCALHOST.into(),
            port: None,
            patience: Patience::default(),
            rates: Rates::default(),
        }
    }
}

/// An annotator, as somebody who looks at the server sees them.
#[derive(Clone, Debug)]
pub struct Standing {
    /// Their name.
    pub annotator: String,
    /// The link that is theirs alone.
    pub link: String,
    /// Their session.
    pub session: PathBuf,
    /// Queries that they have answered or skipped.
    pub n_done: usize,
    /// Queries in all.
    pub n_all: usize,
}

/// A session that is offered, as soon as somebody calls [`Self::run`].
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    desk: Arc<Desk>,
    links: Vec<String>,
    patience: Patience,
    at: SocketAddr,
    rate: f64,
    n_drawn: usize,
}

impl Server {
    /// Prepares everything: queries, annotators' sessions, tokens, and the port. Dreams were dreamed with `model`.
    pub fn open(config: &ServeConfig, model: &WorldModel) -> Result<Self, ServeError> {
        let folders = folders(config)?;
        let n_drawn = match config.n_queries {
            None => 0,
            Some(n) => {
                draw(&mut SessionStore::open(&config.session, Some(model.identity()))?, n, config.strategy)?
            }
        };
        let (mut rooms, mut dreams) = (Vec::new(), Vec::new());
        for (annotator, folder) in config.annotators.iter().zip(&folders) {
            let mut store = hand_out(&config.session, folder, annotator)?;
            store.bind_model(model.identity())?;
            let names = read_dreams(&store, &mut dreams);
            rooms.push(Room::new(annotator.clone(), store, Arc::clone(model.spec()), names));
        }
        if let Some(room) = rooms.iter().find(|room| room.n_done().1 == 0) {
            let (protocol, path) = (room.store().session().protocol(), config.session.clone());
            return Err(ServeError::NoQueries { protocol, path });
        }
        let numbered = (0..).map(DreamId).zip(dreams.into_iter().map(|(_, dream)| dream)).collect();
        let clips = Clips::new(model.parameters(), numbered);
        // Tokens are secrets: these are the only numbers that no seed gives again.
        let chance = |met: rand::rngs::SysError| ServeError::Begin(std::io::Error::other(met.to_string()));
        let mut rng = ChaCha20Rng::try_from_rng(&mut SysRng).map_err(chance)?;
        let (listener, tokens) = listen(config, &mut rng)?;
        let at = listener.local_addr().map_err(ServeError::Wait)?;
        let own: Vec<&str> = config.annotators.iter().map(|name| tokens.tokens[name].as_str()).collect();
        let host = reachable(at);
        let links = own.iter().map(|token| format!("http://{host}/#{token}")).collect();
        let doorkeeper = Doorkeeper::new(own.into_iter());
        let rate = rooms[0].view().rate();
        let desk = Arc::new(Desk::new(rooms, doorkeeper, clips, config.rates, at, rng));
        Ok(Self { listener, desk, links, patience: config.patience, at, rate, n_drawn })
    }

    /// Where it listens.
    pub fn at(&self) -> SocketAddr {
        self.at
    }

    /// How many queries were drawn for it.
    pub fn n_drawn(&self) -> usize {
        self.n_drawn
    }

    /// Frames a second at which clips are played at first.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// The annotators, their links, and how far they are.
    pub fn standings(&self) -> Vec<Standing> {
        let all = self.desk.standing().zip(&self.links);
        all.map(|(room, link)| {
            let (n_done, n_all) = room.n_done();
            let (annotator, session) = (room.annotator().to_owned(), room.store().dir().to_owned());
            Standing { annotator, link: link.clone(), session, n_done, n_all }
        })
        .collect()
    }

    /// Answers whoever comes, until it is told to stop.
    pub fn run(&self, stop: &AtomicBool) -> Result<(), ServeError> {
        let connected: Arc<Mutex<HashMap<IpAddr, usize>>> = Arc::default();
        let (desk, patience) = (Arc::clone(&self.desk), self.patience);
        let crew =
            Crew::spawn("serve", N_HANDS, N_WAITING, move |(mut stream, guest): (TcpStream, Guest)| {
                attend(&desk, &mut stream, guest.address, patience);
            })
            .map_err(ServeError::Begin)?;
        // Somebody who is gone before being accepted is not waited for.
        self.listener.set_nonblocking(true).map_err(ServeError::Wait)?;
        while !stop.load(Ordering::Relaxed) {
            let mut ready = [PollFd::from_borrowed_fd(self.listener.as_fd(), PollFlags::IN)];
            match poll(&mut ready, Some(&LOOK_EVERY)) {
                Ok(0) => continue,
                Err(met) if met == rustix::io::Errno::INTR => continue,
                Err(met) => return Err(ServeError::Wait(met.into())),
                Ok(_) => {}
            }
            let Ok((stream, peer)) = self.listener.accept() else {
                // None is free, as where too many files are open: those at work end in seconds.
                crate::worker::pause(Duration::from_millis(20));
                continue;
            };
            if stream.set_nonblocking(false).is_err() {
                continue;
            }
            let Some(guest) = Guest::enter(&connected, peer.ip()) else {
                send_away(stream);
                continue;
            };
            if let Err((stream, _)) = crew.offer((stream, guest)) {
                send_away(stream);
            }
        }
        Ok(())
    }
}

/// A connection that counts for its address as long as it is there.
#[derive(Debug)]
struct Guest {
    address: IpAddr,
    connected: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

impl Guest {
    /// One more of this address, where that has not too many.
    fn enter(connected: &Arc<Mutex<HashMap<IpAddr, usize>>>, address: IpAddr) -> Option<Self> {
        let mut all = connected.lock().unwrap_or_else(PoisonError::into_inner);
        let n = all.entry(address).or_default();
        if *n >= N_OF_ONE {
            return None;
        }
        *n += 1;
        Some(Self { address, connected: Arc::clone(connected) })
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        let mut all = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(n) = all.get_mut(&self.address) {
            *n -= 1;
            if *n == 0 {
                all.remove(&self.address);
            }
        }
    }
}

/// Reads the request of a connection and answers it.
fn attend(desk: &Desk, stream: &mut TcpStream, peer: IpAddr, patience: Patience) {
    let began = Instant::now();
    stream.set_nodelay(true).ok();
    let read = desk.admits(peer, began).and_then(|()| http::read(stream, began + patience.request));
    let (response, is_whole) = match read {
        Ok(None) => return,
        Ok(Some(request)) => {
            let response = desk.answer(&request, Instant::now());
            log::debug!("{peer} {:?} {}: {}", request.method, request.path, response.status);
            (response, true)
        }
        Err(refused) => {
            log::debug!("{peer}: {} {}", refused.status, refused.why);
            (Response::from(refused), false)
        }
    };
    let sent = response.send(stream, Instant::now() + patience.response);
    if sent.is_ok() && !is_whole {
        http::drain(stream, Instant::now() + DRAIN);
    }
}

/// Says that nobody has time, and takes next to none for that.
fn send_away(mut stream: TcpStream) {
    let busy = Response::from(Refused::new(503, "nobody has time at the moment: ask again"));
    busy.send(&mut stream, Instant::now() + HURRY).ok();
    http::drain(&mut stream, Instant::now() + HURRY);
}

/// The folders of the annotators' sessions.
fn folders(config: &ServeConfig) -> Result<Vec<PathBuf>, ServeError> {
    if config.annotators.is_empty() {
        return Err(ServeError::Nobody);
    }
    let mut taken: BTreeMap<PathBuf, &String> = BTreeMap::new();
    let mut folders = Vec::new();
    for annotator in &config.annotators {
        let folder = annotator_folder(&config.session, config.out.as_deref(), annotator);
        if let Some(other) = taken.insert(folder.clone(), annotator) {
            return Err(ServeError::SameFolder { one: other.clone(), other: annotator.clone() });
        }
        folders.push(folder);
    }
    Ok(folders)
}

/// Listens where it is wanted, and notes the port beside the tokens, so that links last.
fn listen(config: &ServeConfig, rng: &mut ChaCha20Rng) -> Result<(TcpListener, Tokens), ServeError> {
    let path = config.tokens.clone().unwrap_or_else(|| config.session.join(TOKENS_FILE));
    let before = Tokens::read(&path)?;
    let mut tokens = before.clone();
    tokens.complete(&config.annotators, rng);
    let at = SocketAddr::new(config.address, config.port.or(before.port).unwrap_or(0));
    let listener = TcpListener::bind(at).map_err(|met| ServeError::Listen { at, met })?;
    tokens.port = Some(listener.local_addr().map_err(ServeError::Wait)?.port());
    if tokens != before {
        tokens.write(&path)?;
    }
    Ok((listener, tokens))
}

/// How `at` is called by those who are to reach it: where it is every address of this machine, the one that leads out.
fn reachable(at: SocketAddr) -> SocketAddr {
    if !at.ip().is_unspecified() {
        return at;
    }
    // Nothing is sent: the system only says from where it would be.
    let (from, to): (IpAddr, IpAddr) = if at.is_ipv4() {
        (Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into())
    } else {
        (Ipv6Addr::UNSPECIFIED.into(), Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into())
    };
    let own = UdpSocket::bind((from, 0)).and_then(|socket| {
        socket.connect((to, 9))?;
        Ok(socket.local_addr()?.ip())
    });
    SocketAddr::new(own.unwrap_or(at.ip()), at.port())
}
