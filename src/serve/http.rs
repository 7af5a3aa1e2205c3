//! One request and one response a connection, as HTTP/1.1 has them, within limits of size and time.
//!
//! A page asks little: a connection that stays open would keep a thread from others for longer than it saves. What is
//! larger, slower or stranger than the page ever sends is refused with one sentence, and never waited for.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;

/// Bytes of the head of a request at the most.
const MOST_OF_A_HEAD: usize = 8 << 10;
/// Headers at the most.
const MOST_HEADERS: usize = 64;
/// Bytes of what is sent with a request at the most: an answer has some two hundred.
pub(super) const MOST_OF_A_BODY: usize = 4 << 10;
/// What was sent is read to its end up to here, so that who sent it reads why it was refused.
const MOST_UNREAD: usize = 256 << 10;
/// Bytes that are written at once.
const PIECE: usize = 16 << 10;

/// How long clients may take.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// To send a request, from when it was connected.
    pub request: Duration,
    /// To take the response.
    pub response: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { request: Duration::from_secs(5), response: Duration::from_secs(20) }
    }
}

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    Get,
    Post,
}

/// A request that is whole.
#[derive(Debug)]
pub(super) struct Request {
    pub(super) method: Method,
    /// Without what stands behind a question mark.
    pub(super) path: String,
    pub(super) host: Option<String>,
    pub(super) origin: Option<String>,
    /// What `Authorization: Bearer` names.
    pub(super) token: Option<String>,
    pub(super) body: Vec<u8>,
}

/// What is answered.
#[derive(Debug)]
pub(super) struct Response {
    pub(super) status: u16,
    pub(super) kind: &'static str,
    pub(super) body: Arc<[u8]>,
    /// The policy under which a page runs, where it is one.
    pub(super) policy: Option<String>,
}

/// Why a request is not answered: the status, and one sentence.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Refused {
    pub(super) status: u16,
    pub(super) why: String,
    /// The number that an act should have had, where it had another.
    pub(super) nr: Option<usize>,
}

impl Refused {
    pub(super) fn new(status: u16, why: impl Into<String>) -> Self {
        Self { status, why: why.into(), nr: None }
    }
}

#[derive(Serialize)]
struct Told<'a> {
    error: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    nr: Option<usize>,
}

impl From<Refused> for Response {
    fn from(refused: Refused) -> Self {
        Self::json(refused.status, &Told { error: &refused.why, nr: refused.nr })
    }
}

impl Response {
    /// Plain data.
    pub(super) fn json(status: u16, body: &impl Serialize) -> Self {
        let body = serde_json::to_vec(body).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        Self { status, kind: "application/json", body: body.into(), policy: None }
    }

    /// Its head, as it is sent.
    fn head(&self) -> String {
        let Self { status, kind, body, policy } = self;
        let reason = match status {
            200 => "OK",
            400 => "Bad Request",
            401 => "Unauthorized",
            403 => "Forbidden",
            404 => "Not Found",
            405 => "Method Not Allowed",
            408 => "Request Timeout",
            409 => "Conflict",
            411 => "Length Required",
            413 => "Content Too Large",
            417 => "Expectation Failed",
            422 => "Unprocessable Content",
            429 => "Too Many Requests",
            431 => "Request Header Fields Too Large",
            503 => "Service Unavailable",
            505 => "HTTP Version Not Supported",
            _ => "Internal Server Error",
        };
        let more = match status {
            401 => "WWW-Authenticate: Bearer\r\n",
            405 => "Allow: GET, POST\r\n",
            429 | 503 => "Retry-After: 1\r\n",
            _ => "",
        };
        let policy =
            policy.as_ref().map_or_else(String::new, |it| format!("Content-Security-Policy: {it}\r\n"));
        format!(
            "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\n{policy}{more}\r\n",
            body.len()
        )
    }

    /// Sends it, and ends the connection.
    pub(super) fn send(&self, stream: &mut TcpStream, until: Instant) -> io::Result<()> {
        let head = self.head();
        for piece in std::iter::once(head.as_bytes()).chain(self.body.chunks(PIECE)) {
            stream.set_write_timeout(Some(left(until)?))?;
            stream.write_all(piece)?;
        }
        stream.shutdown(Shutdown::Write)
    }
}

/// The time that is left.
fn left(until: Instant) -> io::Result<Duration> {
    let left = until.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(io::ErrorKind::TimedOut.into()) } else { Ok(left) }
}

/// Reads what a client sends. Nothing where not a word came.
pub(super) fn read(stream: &mut TcpStream, until: Instant) -> Result<Option<Request>, Refused> {
    let mut bytes = Vec::with_capacity(1 << 10);
    let (mut request, n_head, n_body) = loop {
        if let Some(parsed) = parse(&bytes)? {
            break parsed;
        }
        if bytes.len() > MOST_OF_A_HEAD {
            let why = format!("the head of a request has {MOST_OF_A_HEAD} bytes at the most");
            return Err(Refused::new(431, why));
        }
        match more(stream, &mut bytes, until) {
            // Browsers connect ahead of what they will ask.
            Ok(0) | Err(_) if bytes.is_empty() => return Ok(None),
            Ok(0) => return Err(Refused::new(400, "the request ends before its head does")),
            read => {
                read?;
            }
        }
    };
    if n_body > MOST_OF_A_BODY {
        return Err(Refused::new(413, format!("{MOST_OF_A_BODY} bytes are taken at the most")));
    }
    while bytes.len() < n_head + n_body {
        if more(stream, &mut bytes, until)? == 0 {
            return Err(Refused::new(400, "the request ends before what it announced"));
        }
    }
    request.body = bytes[n_head..n_head + n_body].to_vec();
    Ok(Some(request))
}

/// Reads on. Nothing is left where that is 0.
fn more(stream: &mut TcpStream, bytes: &mut Vec<u8>, until: Instant) -> Result<usize, Refused> {
    let mut buffer = [0; 2048];
    let mut read = || -> io::Result<usize> {
        stream.set_read_timeout(Some(left(until)?))?;
        stream.read(&mut buffer)
    };
    loop {
        match read() {
            Ok(n) => {
                bytes.extend_from_slice(&buffer[..n]);
                return Ok(n);
            }
            Err(met) if met.kind() == io::ErrorKind::Interrupted => {}
            Err(met) if matches!(met.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                return Err(Refused::new(408, "the request took too long to arrive"));
            }
            // Nobody is there to be told.
            Err(_) => return Ok(0),
        }
    }
}

/// Reads what is still on its way for a moment: a connection that ends with something unread ends before its response.
pub(super) fn drain(stream: &mut TcpStream, until: Instant) {
    let mut bytes = Vec::new();
    while bytes.len() < MOST_UNREAD && matches!(more(stream, &mut bytes, until), Ok(1..)) {}
}

/// The request whose head is at the beginning of `bytes`, how long that is, and how many bytes come with it. Nothing
/// where more is to come.
fn parse(bytes: &[u8]) -> Result<Option<(Request, usize, usize)>, Refused> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut head = httparse::Request::new(&mut headers);
    let n_head = match head.parse(bytes) {
        Ok(httparse::Status::Complete(n)) if n <= MOST_OF_A_HEAD => n,
        Ok(httparse::Status::Complete(_)) | Err(httparse::Error::TooManyHeaders) => {
            return Err(Refused::new(431, format!("a request has {MOST_HEADERS} headers at the most")));
        }
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::Version) => return Err(Refused::new(505, "HTTP/1.1 is spoken here")),
        Err(met) => return Err(Refused::new(400, format!("this is no request of HTTP/1.1: {met}"))),
    };
    let method = match head.method {
        Some("GET") => Method::Get,
        Some("POST") => Method::Post,
        _ => return Err(Refused::new(405, "GET and POST are understood")),
    };
    let all = |name: &'static str| {
        let named = head.headers.iter().filter(move |header| header.name.eq_ignore_ascii_case(name));
        named.map(|header| std::str::from_utf8(header.value).unwrap_or("?").trim())
    };
    let one = |name: &'static str| match (all(name).next(), all(name).nth(1)) {
        (_, Some(_)) => Err(Refused::new(400, format!("{name} is said twice"))),
        (one, None) => Ok(one.map(str::to_owned)),
    };
    if all("Transfer-Encoding").next().is_some() {
        return Err(Refused::new(411, "what is sent is to be announced by its length"));
    }
    if all("Expect").next().is_some() {
        return Err(Refused::new(417, "nothing is expected of what has not been sent"));
    }
    let n_body = match one("Content-Length")? {
        None => 0,
        Some(text) if !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()) => {
            text.parse().unwrap_or(usize::MAX / 2)
        }
        Some(_) => return Err(Refused::new(400, "the length is no whole number")),
    };
    let token = one("Authorization")?.and_then(|told| {
        let (scheme, token) = told.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| token.trim().to_owned())
    });
    let target = head.path.unwrap_or("/");
    let path = target.split(['?', '#']).next().unwrap_or("/").to_owned();
    let request =
        Request { method, path, host: one("Host")?, origin: one("Origin")?, token, body: Vec::new() };
    Ok(Some((request, n_head, n_body)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn status(bytes: &[u8]) -> Option<u16> {
        parse(bytes).err().map(|refused| refused.status)
    }

    #[test]
    fn a_request_is_read_and_what_is_none_is_refused_with_its_status() {
        let text = b"POST /api/act?x=1 HTTP/1.1\r\nHost: here:80\r\nauthorization: bearer  abc \r\n\
                     Content-Length: 5\r\n\r\nhello";
        let (request, n_head, n_body) = parse(text).unwrap().unwrap();
        assert_eq!((request.method, request.path.as_str(), n_body), (Method::Post, "/api/act", 5));
        assert_eq!((request.token.as_deref(), request.host.as_deref()), (Some("abc"), Some("here:80")));
        assert_eq!(&text[n_head..], b"hello");
        assert!((0..n_head).all(|n| matches!(parse(&text[..n]), Ok(None))), "half a head is no request yet");
        let cases: [(&[u8], u16); 7] = [
            (b"\x16\x03\x01\x02\x00", 400),
            (b"GET / HTTP/2.0\r\n\r\n", 505),
            (b"DELETE / HTTP/1.1\r\n\r\n", 405),
            (b"GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", 400),
            (b"GET / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
            (b"GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", 411),
            (b"GET / HTTP/1.1\r\nExpect: 100-continue\r\n\r\n", 417),
        ];
        for (text, expected) in cases {
            assert_eq!(status(text), Some(expected), "{:?}", String::from_utf8_lossy(text));
        }
        let long = b"POST / HTTP/1.1\r\nContent-Length: 99999999999999999999999999\r\n\r\n";
        assert!(parse(long).unwrap().unwrap().2 > MOST_OF_A_BODY, "refused by its size");
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MOST_HEADERS + 1));
        assert_eq!(status(many.as_bytes()), Some(431));
    }

    proptest! {
        #[test]
        fn no_bytes_whatever_bring_it_down(bytes in prop::collection::vec(any::<u8>(), 0..300), n in 0usize..80) {
            parse(&bytes).ok();
            let mut text = b"POST /api/act HTTP/1.1\r\nContent-Length: 5\r\nAuthorization: Bearer x\r\n\r\n".to_vec();
            text.truncate(n);
            text.extend(bytes);
            parse(&text).ok();
        }
    }
}
