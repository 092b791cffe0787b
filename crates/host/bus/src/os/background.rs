//! Threads with ports of their own: ports belong to the thread that opens them.

use std::io;
use std::mem::{ManuallyDrop, forget};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

/// Work that is done step by step.
pub trait Steps {
    /// Does what is due. `last`: this is the last call. Returns the longest pause before the next
    /// step, or `None` if there is nothing more to do.
    fn step(&mut self, last: bool) -> Option<Duration>;
}

/// Work that is done in rounds, until it is asked to end, with a `T`, or fails.
pub trait Rounds<T, E> {
    /// Does what is due, and waits for more. Returns a pause before the next round. Zero after a
    /// round that has waited.
    ///
    /// # Errors
    /// The work ends with it.
    fn round(&mut self) -> Result<Duration, E>;

    /// Ends the work after its last round.
    ///
    /// # Errors
    /// The work ends with it.
    fn finish(self) -> Result<T, E>;
}

/// A running thread that has opened its ports. Stopped when dropped. It ends with a `T`.
///
/// Belongs to the process that started it: a child made by `fork` has no such thread, and waits for
/// none.
#[derive(Debug)]
pub struct Background<T = ()> {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<T>>,
    watch: ThreadWatch,
    pid: u32,
}

/// Tells whether a thread has ended, for whoever needs the thread and does not own it.
#[derive(Debug, Clone)]
pub struct ThreadWatch {
    name: Arc<str>,
    /// The thread has the other end.
    lives: Weak<()>,
}

impl ThreadWatch {
    /// The thread's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// True if it has ended, by itself, by a panic, or because it was asked to.
    pub fn has_ended(&self) -> bool {
        self.lives.strong_count() == 0
    }
}

/// The thread's channel to its starter, and the starter's stop flag.
#[derive(Debug)]
pub struct Running<J = ()> {
    stop: Arc<AtomicBool>,
    joined: SyncSender<J>,
}

/// The thread has panicked.
#[derive(Debug, thiserror::Error)]
#[error("the thread {name} panicked")]
#[allow(missing_docs)] // The messages name the fields.
pub struct Panicked {
    pub name: String,
}

impl<J> Running<J> {
    /// The ports are open: [`Background::run`] returns. To be called once.
    pub fn joined(&self, with: J) {
        // The starter waits for it.
        let _ = self.joined.send(with);
    }

    /// True if the thread is to end.
    pub fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl Background {
    /// Starts a thread of the name `name`, waits until `open` has returned in it, and lets it
    /// repeat its steps.
    ///
    /// # Errors
    /// The error of `open`, or the system's if the thread could not be started.
    pub fn start<S: Steps, E: From<io::Error> + Send + 'static>(
        name: &str,
        open: impl FnOnce() -> Result<S, E> + Send + 'static,
    ) -> Result<Self, E> {
        let work = move |running: &Running<_>| match open() {
            Ok(mut steps) => {
                running.joined(Ok(()));
                repeat(|last| steps.step(last), running);
            }
            Err(error) => running.joined(Err(error)),
        };
        let (background, opened) = Self::spawn(name, work)?;
        opened.unwrap_or_else(|| Err(early(name).into()))?;
        Ok(background)
    }
}

impl<T: Send + 'static, E: From<io::Error> + Send + 'static> Background<Result<T, E>> {
    /// Starts a thread of the name `name` that does `work`, and waits until it has
    /// [joined](Running::joined). Returns what it has joined with, too.
    ///
    /// # Errors
    /// The error of `work` if it ends before, or the system's if the thread could not be started.
    pub fn run<J: Send + 'static>(
        name: &str,
        work: impl FnOnce(&Running<J>) -> Result<T, E> + Send + 'static,
    ) -> Result<(Self, J), E> {
        let (mut background, joined) = Self::spawn(name, work)?;
        if let Some(joined) = joined {
            return Ok((background, joined));
        }
        Err(match background.finish() {
            Ok(Some(Err(error))) => error,
            _ => early(name).into(),
        })
    }

    /// Starts a thread of the name `name`, waits until `open` has returned in it, and lets it
    /// repeat its rounds. Returns what `open` adds, too.
    ///
    /// # Errors
    /// The error of `open`, or the system's if the thread could not be started.
    pub fn repeat<W: Rounds<T, E>, J: Send + 'static>(
        name: &str,
        open: impl FnOnce() -> Result<(W, J), E> + Send + 'static,
    ) -> Result<(Self, J), E> {
        Self::run(name, |running| {
            let (mut work, joined) = open()?;
            running.joined(joined);
            let mut ended = Ok(());
            let round = |last: bool| {
                let round = (!last).then(|| work.round())?;
                round.map_err(|error| ended = Err(error)).ok()
            };
            repeat(round, running);
            ended.and_then(|()| work.finish())
        })
    }

    /// Stops the thread, and returns what it ended with.
    ///
    /// # Errors
    /// The error of its work, or [`Panicked`] in an [`io::Error`].
    pub fn join(mut self) -> Result<T, E> {
        match self.finish().map_err(io::Error::other)? {
            Some(ended) => ended,
            None => Err(io::Error::other("the thread is that of another process").into()),
        }
    }
}

impl<T: Send + 'static> Background<T> {
    fn spawn<J: Send + 'static>(
        name: &str,
        work: impl FnOnce(&Running<J>) -> T + Send + 'static,
    ) -> io::Result<(Self, Option<J>)> {
        let stop = Arc::new(AtomicBool::new(false));
        let (joined, started) = sync_channel(1);
        let running = Running { stop: Arc::clone(&stop), joined };
        let builder = std::thread::Builder::new().name(name.to_owned());
        let lives = Arc::new(());
        let watch = ThreadWatch { name: name.into(), lives: Arc::downgrade(&lives) };
        let thread = builder.spawn(move || {
            let _lives = lives;
            work(&running)
        })?;
        let background = Self { stop, thread: Some(thread), watch, pid: process::id() };
        Ok((background, started.recv().ok()))
    }
}

impl<T> Background<T> {
    /// True if the thread has ended by itself.
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Tells others whether the thread has ended.
    pub fn watch(&self) -> ThreadWatch {
        self.watch.clone()
    }

    /// Ends the pause of the thread: its next step is due.
    pub fn wake(&self) {
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }

    /// Asks the thread to end, and does not wait for it.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
        self.wake();
    }

    /// Leaves the thread to itself: it ends when its work does.
    pub fn detach(mut self) {
        self.thread = None;
    }

    /// Lets the thread do its last step, and waits for it. Returns what it ended with the first
    /// time.
    ///
    /// # Errors
    /// [`Panicked`].
    pub fn finish(&mut self) -> Result<Option<T>, Panicked> {
        self.stop();
        let Some(thread) = self.thread.take() else {
            return Ok(None);
        };
        if self.pid != process::id() {
            forget(thread);
            return Ok(None);
        }
        let name = thread.thread().name().unwrap_or_default().to_owned();
        thread.join().map(Some).map_err(|_| Panicked { name })
    }
}

impl<T> Drop for Background<T> {
    fn drop(&mut self) {
        if let Err(error) = self.finish() {
            tracing::error!("{error}");
        }
    }
}

/// Makes the calls that other threads send for `state`, and drops it after the last. After a call
/// that panicked it makes no more, and leaves the state as it is: in what shape that is is unknown,
/// and others may still refer to memory that it has lent them. Returns false then.
pub fn make_calls<S, C: FnOnce(&mut S)>(state: S, calls: impl IntoIterator<Item = C>) -> bool {
    let mut state = ManuallyDrop::new(state);
    for call in calls {
        if catch_unwind(AssertUnwindSafe(|| call(&mut state))).is_err() {
            return false;
        }
    }
    drop(ManuallyDrop::into_inner(state));
    true
}

fn early(name: &str) -> io::Error {
    io::Error::other(format!("the thread {name} died at its start"))
}

fn repeat<J>(mut step: impl FnMut(bool) -> Option<Duration>, running: &Running<J>) {
    loop {
        let last = running.is_stopping();
        match step(last) {
            // Even a pause of nothing would last as long as the kernel's timer slack, 50 µs.
            Some(Duration::ZERO) if !last => {}
            Some(pause) if !last => std::thread::park_timeout(pause),
            _ => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use joulebus_testkit::eventually;

    use super::*;

    struct Counted {
        calls: Arc<Mutex<Vec<bool>>>,
        most: usize,
    }

    impl Steps for Counted {
        fn step(&mut self, last: bool) -> Option<Duration> {
            let mut calls = self.calls.lock().unwrap();
            calls.push(last);
            (calls.len() < self.most).then_some(Duration::from_secs(3_600))
        }
    }

    fn counted(most: usize) -> (Counted, Arc<Mutex<Vec<bool>>>) {
        let calls = Arc::new(Mutex::new(Vec::new()));
        let of_thread = Arc::clone(&calls);
        (Counted { calls: of_thread, most }, calls)
    }

    #[test]
    fn the_last_step_is_done_without_waiting_for_the_pause_and_once() {
        let (steps, calls) = counted(100);
        let mut background = Background::start("steps", move || io::Result::Ok(steps)).unwrap();
        background.finish().unwrap();
        background.finish().unwrap();
        drop(background);
        let calls = calls.lock().unwrap();
        assert_eq!(calls.iter().filter(|last| **last).count(), 1);
        assert_eq!(calls.last(), Some(&true));
    }

    #[test]
    fn work_is_asked_to_end_and_its_result_or_the_reason_that_it_did_not_join_is_returned() {
        let (background, joined) = Background::run("works", |running| {
            running.joined(7);
            while !running.is_stopping() {
                std::thread::park();
            }
            io::Result::Ok("done")
        })
        .unwrap();
        assert!(!background.has_ended());
        assert_eq!((joined, background.join().unwrap()), (7, "done"));
        let early = |end: fn() -> io::Result<()>| {
            let ended = Background::run("ends", move |_: &Running| end());
            ended.unwrap_err().to_string()
        };
        assert_eq!(early(|| Err(io::Error::other("not today"))), "not today");
        assert!(early(|| Ok(())).contains("thread ends died"));
        assert!(early(|| panic!("at the start")).contains("thread ends died"));
    }

    #[test]
    fn the_end_of_a_thread_is_seen_however_it_ends() {
        struct Panics;
        impl Steps for Panics {
            fn step(&mut self, _: bool) -> Option<Duration> {
                panic!("in a step")
            }
        }
        let (steps, _) = counted(100);
        let mut background = Background::start("lasts", move || io::Result::Ok(steps)).unwrap();
        let watch = background.watch();
        assert!(!watch.has_ended() && watch.name() == "lasts");
        background.finish().unwrap();
        assert!(watch.has_ended());
        let (once, _) = counted(1);
        let ended = Background::start("ends", move || io::Result::Ok(once)).unwrap();
        let panicked = Background::start("panics", || io::Result::Ok(Panics)).unwrap();
        for background in [ended, panicked] {
            let watch = background.watch();
            eventually("its end is seen", || watch.has_ended() && background.has_ended());
        }
    }

    #[test]
    fn what_a_panicking_call_leaves_is_neither_used_nor_dropped() {
        type Call = fn(&mut Arc<AtomicBool>);
        let used: Call = |state| state.store(true, Ordering::Relaxed);
        let panics: Call = |_| panic!("in a call");
        for (calls, is_used, is_left) in
            [(vec![used], true, false), (vec![panics, used], false, true)]
        {
            let state = Arc::new(AtomicBool::new(false));
            assert_eq!(make_calls(Arc::clone(&state), calls), !is_left);
            assert_eq!(state.load(Ordering::Relaxed), is_used);
            assert_eq!(Arc::strong_count(&state), 1 + usize::from(is_left));
        }
    }

    struct Failing(u32);

    impl Rounds<u32, io::Error> for Failing {
        fn round(&mut self) -> io::Result<Duration> {
            self.0 += 1;
            if self.0 == 3 { Err(io::Error::other("not today")) } else { Ok(Duration::ZERO) }
        }

        fn finish(self) -> io::Result<u32> {
            Ok(self.0)
        }
    }

    #[test]
    fn rounds_are_repeated_until_one_fails_or_the_thread_is_to_end() {
        let (background, ()) = Background::repeat("fails", || Ok((Failing(0), ()))).unwrap();
        eventually("a round fails", || background.has_ended());
        assert_eq!(background.join().unwrap_err().to_string(), "not today");
        let (background, joined) = Background::repeat("ends", || Ok((Failing(3), 7))).unwrap();
        assert!(joined == 7 && background.join().unwrap() >= 3);
        let refused = Background::repeat("refused", || Err::<(Failing, ()), _>(early("it")));
        assert!(refused.unwrap_err().to_string().contains("it died"));
    }

    #[test]
    fn a_child_of_a_fork_does_not_wait_for_a_thread_that_it_does_not_have() {
        let (mut background, ()) = Background::run("stays", |running| {
            running.joined(());
            io::Result::Ok(())
        })
        .unwrap();
        // As in the child.
        background.pid += 1;
        assert!(background.finish().unwrap().is_none());
    }

    #[test]
    fn work_that_has_ended_is_not_repeated_and_errors_of_the_start_are_returned() {
        let (steps, calls) = counted(1);
        let mut background = Background::start("steps", move || io::Result::Ok(steps)).unwrap();
        background.finish().unwrap();
        assert_eq!(calls.lock().unwrap().len(), 1);
        let refused =
            Background::start("refused", || Err::<Counted, _>(io::Error::other("not today")));
        assert_eq!(refused.unwrap_err().to_string(), "not today");
        let died = Background::start("dies", || -> io::Result<Counted> { panic!("at the start") });
        assert!(died.unwrap_err().to_string().contains("thread dies died"));
    }
}
