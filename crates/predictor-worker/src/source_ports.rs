//! The ports of sources: a source whose port is gone has ended.

use joulebus_bus::{IncomingFrame, WriterWatch};

/// Number of ports that are watched. Sources beyond it end by their silence.
const MAX_PORTS: usize = 256;
/// Interval between looks at all ports, ns.
const LOOK_EVERY_NS: u64 = 100_000_000;

/// A run of a source: its id and its epoch.
type SourceRun = (u64, u64);

/// The ports that have sent frames of sources on this host. Frames that a link passed on are not
/// among them: their source may live on when the link ends.
#[derive(Debug)]
pub(crate) struct SourcePorts {
    ports: Vec<SourcePort>,
    look_at_ns: u64,
}

/// One for each source that a port sends for.
#[derive(Debug)]
struct SourcePort {
    port: u128,
    watch: WriterWatch,
    /// The newest run of which a frame was admitted. Refused frames end no run.
    run: Option<SourceRun>,
    is_gone: bool,
}

impl SourcePorts {
    pub(crate) fn new() -> Self {
        Self { ports: Vec::with_capacity(MAX_PORTS), look_at_ns: 0 }
    }

    /// Looks for ports that are gone, if it is time for that. Their last frames may still wait: all
    /// that wait now are to be taken before [`SourcePorts::end_gone`].
    pub(crate) fn look(&mut self, now_ns: u64) {
        if now_ns >= self.look_at_ns {
            self.look_at_ns = now_ns.saturating_add(LOOK_EVERY_NS);
            self.look_now();
        }
    }

    /// Begins to watch the port of a frame, if it is a new one. Returns whether it is: the source
    /// may be the successor of one that has just ended, so the other ports are looked at.
    pub(crate) fn begin(&mut self, frame: &IncomingFrame<'_>) -> bool {
        let port = frame.port();
        let is_new = !frame.header().is_relayed()
            && self.ports.len() < MAX_PORTS
            && self.ports.iter().all(|known| known.port != port);
        if is_new {
            self.look_now();
            let watch = frame.watch_port();
            self.ports.push(SourcePort { port, watch, run: None, is_gone: false });
        }
        is_new
    }

    /// Notes that a frame was admitted.
    pub(crate) fn admitted(&mut self, frame: &IncomingFrame<'_>) {
        let (port, header) = (frame.port(), frame.header());
        if header.is_relayed() {
            return;
        }
        let run = (header.source_id, header.source_epoch);
        let is_of = |known: &&mut SourcePort| {
            known.port == port && known.run.is_none_or(|(id, _)| id == run.0)
        };
        if let Some(known) = self.ports.iter_mut().find(is_of) {
            known.run = Some(run);
        } else if self.ports.len() < MAX_PORTS {
            // A replay sends for many sources.
            let of_port = self.ports.iter().find(|known| known.port == port);
            let watch = of_port.map_or_else(|| frame.watch_port(), |known| known.watch.clone());
            self.ports.push(SourcePort { port, watch, run: Some(run), is_gone: false });
        }
    }

    /// Forgets the ports that are gone. Calls `ended` with each run that no other port sends.
    pub(crate) fn end_gone(&mut self, mut ended: impl FnMut(SourceRun)) {
        while let Some(at) = self.ports.iter().position(|known| known.is_gone) {
            let gone = self.ports.swap_remove(at);
            if let Some(run) = gone.run
                && self.ports.iter().all(|known| known.run != Some(run))
            {
                ended(run);
            }
        }
    }

    fn look_now(&mut self) {
        for known in &mut self.ports {
            known.is_gone |= !known.watch.is_open();
        }
    }
}
