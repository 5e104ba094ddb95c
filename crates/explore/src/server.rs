//! Connections, their limits, and shutdown.

use std::convert::Infallible;
use std::fmt;
use std::future::{poll_fn, ready};
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::Poll;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full};
use hyper::body::Incoming;
use hyper::header::{CONTENT_TYPE, HeaderMap, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::runtime::Runtime;
use tokio::task::AbortHandle;
use tokio::time::{sleep, timeout};

use crate::auth::RequestAuth;
use crate::catalog::{ExploreConfig, ExploreConfigError};
use crate::error::RequestError;
use crate::routes::{Application, HttpResponse};

/// Maximum number of connections. At the limit, a new connection closes the one that has been idle for the longest
/// time.
const MAX_CONNECTIONS: usize = 256;
/// Maximum size of a request body, in bytes: a scenario of some minutes of scripted motion.
const MAX_BODY_BYTES: usize = 1 << 20;
/// Maximum number of body bytes drained before the connection is dropped.
const MAX_DRAINED_BYTES: usize = 32 << 20;
/// Maximum size of a request head in bytes, and maximum number of headers.
const MAX_HEAD_BYTES: usize = 32 << 10;
const MAX_HEADERS: usize = 64;
/// Time limit of the head of a request, and of its body. Clients run on the same machine.
const READ_TIMEOUT: Duration = Duration::from_secs(10);
/// Retry interval after failures of `accept`, and while no connection can end.
const RETRY_AFTER: Duration = Duration::from_millis(20);

/// Headers of every response. The page loads only from this server, is not cached, and cannot be embedded.
const SECURITY_HEADERS: [(&str, &str); 7] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    // The URL contains the token.
    ("referrer-policy", "no-referrer"),
    ("cache-control", "no-store"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
];

/// Server that listens and does not serve yet.
pub struct Server {
    listener: TcpListener,
    port: u16,
    application: Arc<Application>,
    runtime: Runtime,
    interrupt: Interrupt,
    read_timeout: Duration,
}

impl fmt::Debug for Server {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Server")
            .field("port", &self.port)
            .finish_non_exhaustive()
    }
}

type Interrupt = Pin<Box<dyn Future<Output = io::Result<()>> + Send>>;

/// Reason why the server cannot serve.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] ExploreConfigError),
    /// The server cannot listen on the port.
    #[error("--port {port}: {source}")]
    Port {
        /// Requested port.
        port: u16,
        /// Error of the system.
        source: io::Error,
    },
    /// The system has no random numbers for the token.
    #[error("cannot get random numbers for a token: {0}")]
    Random(#[from] getrandom::Error),
    /// The system accepts no more connections or signals.
    #[error("cannot serve: {0}")]
    System(io::Error),
}

impl Server {
    /// Listens on a port of 127.0.0.1 (0: any). From then on Ctrl-C ends [`Server::run`] instead of the process.
    ///
    /// # Errors
    /// [`ServeError`] if the server cannot listen or the configuration is invalid.
    pub fn bind(port: u16, config: ExploreConfig) -> Result<Self, ServeError> {
        let catalog = config.into_catalog()?;
        let listener = listen(port).map_err(|source| ServeError::Port { port, source })?;
        let port = listener
            .local_addr()
            .map_err(|source| ServeError::Port { port, source })?
            .port();
        let auth = RequestAuth::new(port)?;
        // Each simulation takes one processor; connections share one more thread.
        let processors = std::thread::available_parallelism()
            .map_or(2, usize::from)
            .max(2);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(processors)
            .build()
            .map_err(ServeError::System)?;
        let mut interrupt: Interrupt = Box::pin(tokio::signal::ctrl_c());
        // The first poll sets the handler, so Ctrl-C works as soon as the URL is known.
        let interrupt: Interrupt = match runtime.block_on(poll_fn(|context| {
            Poll::Ready(interrupt.as_mut().poll(context))
        })) {
            Poll::Ready(already) => Box::pin(ready(Ok(already.map_err(ServeError::System)?))),
            Poll::Pending => interrupt,
        };
        let application = Arc::new(Application::new(auth, catalog));
        Ok(Self {
            listener,
            port,
            application,
            runtime,
            interrupt,
            read_timeout: READ_TIMEOUT,
        })
    }

    /// Sets the time limit of the head of a request, and of its body; the default is 10 s.
    #[must_use]
    pub fn with_read_timeout(self, read_timeout: Duration) -> Self {
        Self {
            read_timeout,
            ..self
        }
    }

    /// Returns the URL of the first page, with the token.
    #[must_use]
    pub fn url(&self) -> String {
        self.application.auth.url()
    }

    /// Returns the port.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Serves until Ctrl-C.
    ///
    /// # Errors
    /// [`ServeError::System`] if the system fails.
    pub fn run(self) -> Result<(), ServeError> {
        let done = self.runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            tokio::spawn(accept(listener, self.application, self.read_timeout));
            self.interrupt.await
        });
        // Discard simulations in progress.
        self.runtime.shutdown_background();
        done.map_err(ServeError::System)
    }
}

fn listen(port: u16) -> io::Result<TcpListener> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

async fn accept(
    listener: tokio::net::TcpListener,
    application: Arc<Application>,
    read_timeout: Duration,
) {
    let mut connections = Vec::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Probably out of file descriptors; some will be free soon.
            sleep(RETRY_AFTER).await;
            continue;
        };
        while !try_free_connection(&mut connections) {
            sleep(RETRY_AFTER).await;
        }
        let idle_since = Arc::new(AtomicU64::new(next_tick()));
        let task = tokio::spawn(serve_connection(
            stream,
            Arc::clone(&application),
            Arc::clone(&idle_since),
            read_timeout,
        ));
        connections.push(Connection {
            task: task.abort_handle(),
            idle_since,
        });
    }
}

async fn serve_connection(
    stream: tokio::net::TcpStream,
    application: Arc<Application>,
    idle_since: Arc<AtomicU64>,
    read_timeout: Duration,
) {
    let service =
        service_fn(|request| respond(Arc::clone(&application), request, &idle_since, read_timeout));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(read_timeout)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(stream), service);
    // A client that disconnects needs no response.
    let _ = connection.await;
}

struct Connection {
    task: AbortHandle,
    /// Tick since which the connection is idle, or [`BUSY`].
    idle_since: Arc<AtomicU64>,
}

/// Value for a request in progress.
const BUSY: u64 = u64::MAX;

/// Returns increasing numbers as a clock.
fn next_tick() -> u64 {
    static TICKS: AtomicU64 = AtomicU64::new(0);
    TICKS.fetch_add(1, Ordering::Relaxed)
}

/// Returns true if another connection may begin. At the limit, closes the connection that has been idle for the longest
/// time.
fn try_free_connection(connections: &mut Vec<Connection>) -> bool {
    connections.retain(|connection| !connection.task.is_finished());
    if connections.len() >= MAX_CONNECTIONS {
        let since = connections
            .iter()
            .map(|connection| connection.idle_since.load(Ordering::Relaxed))
            .enumerate();
        if let Some((longest, _)) = since
            .filter(|(_, since)| *since != BUSY)
            .min_by_key(|(_, since)| *since)
        {
            connections.swap_remove(longest).task.abort();
        }
    }
    connections.len() < MAX_CONNECTIONS
}

async fn respond(
    application: Arc<Application>,
    request: Request<Incoming>,
    idle_since: &AtomicU64,
    read_timeout: Duration,
) -> Result<Response<Full<Bytes>>, Infallible> {
    let answered = handle(application, request, idle_since, read_timeout).await;
    let HttpResponse {
        status,
        content_type,
        body,
    } = answered.unwrap_or_else(HttpResponse::from);
    let mut response = Response::new(Full::new(Bytes::from(body)));
    *response.status_mut() = status;
    response
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    for (name, value) in SECURITY_HEADERS {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}

async fn handle(
    application: Arc<Application>,
    request: Request<Incoming>,
    idle_since: &AtomicU64,
    read_timeout: Duration,
) -> Result<HttpResponse, RequestError> {
    // Earlier idle time no longer counts.
    idle_since.store(next_tick(), Ordering::Relaxed);
    let (head, body) = request.into_parts();
    let rest = application
        .auth
        .authorize(head.uri.path(), &head.headers)?
        .to_owned();
    if head.method == Method::GET {
        return application.dispatch(&head.method, &rest, &[]);
    }
    // A form of another page cannot send this content type without a preflight request.
    if head.method == Method::POST && !declares_json(&head.headers) {
        return Err(RequestError::NotJson);
    }
    let body = timeout(read_timeout, read_body(body))
        .await
        .map_err(|_| RequestError::Timeout(read_timeout))??;
    // Requests beyond the number of threads are queued.
    idle_since.store(BUSY, Ordering::Relaxed);
    let answer =
        tokio::task::spawn_blocking(move || application.dispatch(&head.method, &rest, &body)).await;
    idle_since.store(next_tick(), Ordering::Relaxed);
    answer.unwrap_or_else(|_| {
        Err(RequestError::Internal(
            "an internal error of crumple: please report it with the scenario".to_owned(),
        ))
    })
}

fn declares_json(headers: &HeaderMap) -> bool {
    headers
        .get(CONTENT_TYPE)
        .and_then(|kind| kind.to_str().ok())
        .and_then(|kind| kind.split(';').next())
        .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
}

/// Reads a whole body. A body that is too long is drained, because the client reads the error only after sending.
async fn read_body(mut body: Incoming) -> Result<Vec<u8>, RequestError> {
    let mut bytes = Vec::new();
    let mut length = 0_usize;
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| RequestError::Malformed {
            line: 1,
            message: format!("the request is incomplete: {error}"),
        })?;
        let Ok(data) = frame.into_data() else {
            continue;
        };
        length = length.saturating_add(data.len());
        if length <= MAX_BODY_BYTES {
            bytes.extend_from_slice(&data);
        } else if length > MAX_DRAINED_BYTES {
            break;
        }
    }
    if length > MAX_BODY_BYTES {
        Err(RequestError::TooLarge(MAX_BODY_BYTES >> 10))
    } else {
        Ok(bytes)
    }
}
