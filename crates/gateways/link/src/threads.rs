//! The threads of a link, and how they start and end.

use std::sync::Arc;

use joulebus_bus::{Background, Rounds, WorkerLock};
use joulebus_config::Config;
use joulebus_connect::standby::{Permit, StandbyFiles};
use joulebus_plan_server::PlanServer;

use crate::config::{Settings, Side, Standby};
use crate::follow::Following;
use crate::forward::Forwarding;
use crate::intake::Intake;
use crate::leadership::Leadership;
use crate::network::Network;
use crate::outputs::Outputs;
use crate::report::Done;
use crate::shared::Shared;
use crate::standby::{Candidacy, Rivals};

/// Resources that a link claims on its host before it opens the network.
pub(crate) struct HostClaim {
    /// Answers planners' questions on a host without a worker.
    questions: Option<PlanServer>,
    lock: Option<WorkerLock>,
}

impl HostClaim {
    /// Takes the place of a worker, on a host without one.
    ///
    /// # Errors
    /// The fleet cannot be joined, or the host has a worker.
    pub(crate) fn take(config: &Config, settings: &Settings) -> anyhow::Result<Self> {
        let mut claim = Self { questions: None, lock: None };
        if let Side::Other { follow, .. } = &settings.side {
            if follow.is_some() {
                claim.questions = Some(PlanServer::start(config, None)?);
            }
            claim.lock = Some(WorkerLock::acquire(&config.domain()?)?);
        }
        Ok(claim)
    }
}

pub(crate) struct Threads {
    running: Vec<Background<anyhow::Result<Done>>>,
    questions: Option<PlanServer>,
    /// Has the worker lock, and is dropped after the threads have ended.
    shared: Arc<Shared>,
}

impl Threads {
    /// Starts all threads, each of which has joined the fleet when this returns.
    ///
    /// # Errors
    /// The fleet cannot be joined, or the network is refused.
    pub(crate) fn start(
        config: &Config,
        settings: &Settings,
        HostClaim { questions, lock }: HostClaim,
        network: Network,
    ) -> anyhow::Result<Self> {
        let places = StandbyFiles::new(config);
        let resumed = settings.standby.is_some().then(|| Leadership::resume(places)).transpose()?;
        let (leadership, permit) = match resumed {
            Some((leadership, permit)) => (Some(Arc::new(leadership)), permit),
            None => (None, None),
        };
        let shared = Arc::new(Shared {
            config: config.clone(),
            settings: settings.clone(),
            network,
            leadership: leadership.clone(),
            lock,
        });
        let mut threads = Self { running: Vec::new(), questions, shared: Arc::clone(&shared) };
        match &settings.side {
            Side::Worker(takes) => {
                if let Some((standby, leadership)) = settings.standby.as_ref().zip(leadership) {
                    threads.start_standby(&shared, standby, (leadership, permit))?;
                }
                threads.spawn("joulebus-outputs", &shared, Outputs::open)?;
                if !takes.is_empty() {
                    let takes = takes.clone();
                    let open = move |shared: Arc<Shared>| Intake::open(&shared, takes);
                    threads.spawn("joulebus-intake", &shared, open)?;
                }
            }
            Side::Other { samples, follow } => {
                if let Some(follow) = follow.clone() {
                    let open = move |shared: Arc<Shared>| Following::open(&shared, &follow);
                    threads.spawn("joulebus-follow", &shared, open)?;
                }
                if let Some(to) = samples.clone() {
                    let open = move |shared| Forwarding::open(shared, to);
                    threads.spawn("joulebus-forward", &shared, open)?;
                }
            }
        }
        if let Some(questions) = &threads.questions {
            questions.serve();
        }
        Ok(threads)
    }

    /// Starts the threads that decide whether this host's worker leads.
    fn start_standby(
        &mut self,
        shared: &Arc<Shared>,
        standby: &Standby,
        (leadership, permit): (Arc<Leadership>, Option<Permit>),
    ) -> anyhow::Result<()> {
        let (standby, candidate) = (standby.clone(), standby.clone());
        let observer = Arc::clone(&leadership);
        let open = move |shared: Arc<Shared>| Ok(Rivals::open(&shared, observer, &standby)?);
        self.spawn("joulebus-standby", shared, open)?;
        let open =
            move |shared: Arc<Shared>| Candidacy::open(&shared, leadership, &candidate, permit);
        self.spawn("joulebus-lease", shared, open)
    }

    /// Starts a thread, and waits until it has joined the fleet.
    fn spawn<W: Rounds<Done, anyhow::Error> + 'static>(
        &mut self,
        name: &str,
        shared: &Arc<Shared>,
        open: impl FnOnce(Arc<Shared>) -> anyhow::Result<W> + Send + 'static,
    ) -> anyhow::Result<()> {
        let shared = Arc::clone(shared);
        let (thread, ()) = Background::repeat(name, move || Ok((open(shared)?, ())))?;
        self.running.push(thread);
        Ok(())
    }

    pub(crate) fn network(&self) -> &Network {
        &self.shared.network
    }

    /// True if a thread has ended by itself.
    pub(crate) fn have_ended(&self) -> bool {
        self.running.iter().any(Background::has_ended)
    }

    /// Ends all threads.
    pub(crate) fn finish(mut self) -> anyhow::Result<Done> {
        self.running.iter().for_each(Background::stop);
        if let Some(questions) = self.questions.take() {
            let _ = questions.finish();
        }
        let ended: Vec<_> = self.running.drain(..).map(Background::join).collect();
        let mut all = Done::default();
        for done in ended {
            let done = done?;
            all.given.extend(done.given);
            all.taken.extend(done.taken);
            all.refused.add(&done.refused);
        }
        Ok(all)
    }
}
