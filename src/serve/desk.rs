//! Where requests are answered: the page to everybody, all else to whoever has a token.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use rand::Rng as _;
use rand_chacha::ChaCha20Rng;

use crate::query::QueryId;
use crate::serve::clips::Clips;
use crate::serve::http::{Method, Refused, Request, Response};
use crate::serve::limits::{Limits, Rates};
use crate::serve::room::{Numbered, Room};
use crate::serve::tokens::{Doorkeeper, hex};

/// The page, with a place in it for what tells its own script from any other.
const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const SCRIPT: &str = include_str!("page/page.js");

/// Everything that requests are about.
#[derive(Debug)]
pub(super) struct Desk {
    pub(super) rooms: Vec<Mutex<Room>>,
    pub(super) doorkeeper: Doorkeeper,
    pub(super) clips: Mutex<Clips>,
    limits: Mutex<Limits>,
    /// Where it listens.
    at: SocketAddr,
    rng: Mutex<ChaCha20Rng>,
}

/// A lock that one who panicked held is as good as any: what it guards is a fold of what is on disk.
fn lock<T>(it: &Mutex<T>) -> MutexGuard<'_, T> {
    it.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Desk {
    pub(super) fn new(
        rooms: Vec<Room>,
        doorkeeper: Doorkeeper,
        clips: Clips,
        rates: Rates,
        at: SocketAddr,
        rng: ChaCha20Rng,
    ) -> Self {
        Self {
            rooms: rooms.into_iter().map(Mutex::new).collect(),
            doorkeeper,
            clips: Mutex::new(clips),
            limits: Mutex::new(Limits::new(rates)),
            at,
            rng: Mutex::new(rng),
        }
    }

    /// Whether an address may ask once more.
    pub(super) fn admits(&self, address: IpAddr, now: Instant) -> Result<(), Refused> {
        if lock(&self.limits).take_address(address, now) { Ok(()) } else { Err(too_many()) }
    }

    /// What is answered to a request.
    pub(super) fn answer(&self, request: &Request, now: Instant) -> Response {
        self.answered(request, now).unwrap_or_else(Response::from)
    }

    fn answered(&self, request: &Request, now: Instant) -> Result<Response, Refused> {
        self.check_names(request)?;
        match (request.method, request.path.as_str()) {
            (Method::Get, "/") => return Ok(self.page()),
            (Method::Post, "/") => return Err(Refused::new(405, "the page is there to be read")),
            (_, path) if !path.starts_with("/api/") => {
                return Err(Refused::new(404, "there is no such page"));
            }
            _ => {}
        }
        // Whatever is asked: without a token nothing is told, not even whether there is such a thing.
        let token = request.token.as_deref();
        let who = token.and_then(|token| self.doorkeeper.who(token));
        let who =
            who.ok_or_else(|| Refused::new(401, "this needs a link with a token that is known here"))?;
        if !lock(&self.limits).take_annotator(who, now) {
            return Err(too_many());
        }
        let room = &self.rooms[who];
        let parts: Vec<&str> = request.path.split('/').skip(2).collect();
        match (request.method, &parts[..]) {
            (Method::Get, ["view"]) => Ok(Response::json(200, &lock(room).view())),
            (Method::Post, ["act"]) => {
                let told: Numbered = serde_json::from_slice(&request.body)
                    .map_err(|met| Refused::new(400, format!("this is nothing that can be said: {met}")))?;
                let mut room = lock(room);
                room.act(&told)?;
                Ok(Response::json(200, &room.view()))
            }
            (Method::Get, ["clip", query, side]) => self.clip(room, query, side),
            (_, ["view" | "act"] | ["clip", ..]) => Err(Refused::new(405, "this is asked in another way")),
            _ => Err(Refused::new(404, "there is no such thing to ask for")),
        }
    }

    fn clip(&self, room: &Mutex<Room>, query: &str, side: &str) -> Result<Response, Refused> {
        let unknown = || Refused::new(404, "there is no such clip");
        let query = query.parse().map_err(|_| unknown())?;
        let pair = lock(room).clips(QueryId(query)).ok_or_else(unknown)?;
        let wanted = match side {
            "left" => pair[0],
            "right" => pair[1],
            _ => return Err(unknown()),
        };
        let drawn = lock(&self.clips).png(pair, wanted);
        let body = drawn.map_err(|met| {
            log::error!("{met}");
            Refused::new(500, met.to_string())
        })?;
        Ok(Response { status: 200, kind: "image/png", body, policy: None })
    }

    /// A page of another name is not to speak to this one: names can be made to lead here (DNS rebinding).
    ///
    /// On a network the server is called by names that it does not know; there the token alone decides.
    fn check_names(&self, request: &Request) -> Result<(), Refused> {
        let Some(host) = request.host.as_deref() else {
            return Err(Refused::new(400, "a request says to which host it is"));
        };
        let port = self.at.port();
        let is_here = || {
            let name = host.strip_suffix(&format!(":{port}")).unwrap_or(host);
            name.eq_ignore_ascii_case("localhost")
                || name.trim_matches(['[', ']']).parse().is_ok_and(|address: IpAddr| address.is_loopback())
        };
        if self.at.ip().is_loopback() && !is_here() {
            return Err(Refused::new(403, "only this machine is served, under its own name"));
        }
        match request.origin.as_deref() {
            Some(origin) if origin != format!("http://{host}") => {
                Err(Refused::new(403, "pages from elsewhere are not served"))
            }
            _ => Ok(()),
        }
    }

    /// The page: the same for everybody, and it tells nothing of the session.
    fn page(&self) -> Response {
        let mut bytes = [0; 16];
        lock(&self.rng).fill_bytes(&mut bytes);
        let nonce = hex(&bytes);
        let page =
            PAGE.replace("{{nonce}}", &nonce).replace("{{style}}", STYLE).replace("{{script}}", SCRIPT);
        let policy = format!(
            "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; \
             img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        );
        let body: Arc<[u8]> = page.into_bytes().into();
        Response { status: 200, kind: "text/html; charset=utf-8", body, policy: Some(policy) }
    }

    /// Who answers, how far, and in which session.
    pub(super) fn standing(&self) -> impl Iterator<Item = MutexGuard<'_, Room>> {
        self.rooms.iter().map(lock)
    }
}

fn too_many() -> Refused {
    Refused::new(429, "this asks too often: wait a moment")
}
