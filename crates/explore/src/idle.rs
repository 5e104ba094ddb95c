//! Connections that wait for their client: they make room for others, the longest idle first.
//!
//! A connection is idle between requests, and also while a request arrives. A slow client therefore keeps no other client out.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// Idle connections, in the order in which they became idle.
#[derive(Debug, Default)]
pub(crate) struct Idle {
    waiting: Mutex<Waiting>,
}

#[derive(Debug, Default)]
struct Waiting {
    since: BTreeMap<u64, Arc<Notify>>,
    next: u64,
}

/// The place of one connection.
#[derive(Debug)]
pub(crate) struct Place<'a> {
    idle: &'a Idle,
    end: Arc<Notify>,
    /// When it became idle; none while a request is being answered.
    since: Mutex<Option<u64>>,
}

impl Idle {
    /// The place of a new connection, on which nothing was asked yet.
    pub(crate) fn place(&self) -> Place<'_> {
        let end = Arc::new(Notify::new());
        let since = self.join(&end);
        Place { idle: self, end, since: Mutex::new(Some(since)) }
    }

    /// Ends the connection that is idle the longest, if one is.
    pub(crate) fn give_up_oldest(&self) {
        if let Some((_, end)) = lock(&self.waiting).since.pop_first() {
            end.notify_one();
        }
    }

    fn join(&self, end: &Arc<Notify>) -> u64 {
        let mut waiting = lock(&self.waiting);
        let since = waiting.next;
        waiting.next += 1;
        waiting.since.insert(since, Arc::clone(end));
        since
    }
}

impl Place<'_> {
    /// Waits for an answer. The connection is not given up before the answer is there.
    pub(crate) async fn busy<T>(&self, answer: impl Future<Output = T>) -> T {
        self.leave();
        let answer = answer.await;
        self.renew();
        answer
    }

    /// Moves the connection behind all that are idle.
    pub(crate) fn renew(&self) {
        self.leave();
        *lock(&self.since) = Some(self.idle.join(&self.end));
    }

    /// Done once others need its place.
    pub(crate) async fn given_up(&self) {
        self.end.notified().await;
    }

    fn leave(&self) {
        if let Some(since) = lock(&self.since).take() {
            lock(&self.idle.waiting).since.remove(&since);
        }
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.leave();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
