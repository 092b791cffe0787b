//! A process with the controllers and planners of two fleets that also uses iceoryx2 for itself, on
//! its defaults. `run.sh` builds it as a new project and runs it.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, id};
use std::time::{Duration, Instant};
use std::{env, fs};

use iceoryx2::port::publisher::Publisher as OwnPublisher;
use iceoryx2::port::subscriber::Subscriber as OwnSubscriber;
use iceoryx2::prelude::*;
use joulebus_consumer::{Event, Subscriber};
use joulebus_publisher::{Publisher, RobotState};

type Done<T = ()> = Result<T, Box<dyn Error>>;

const PREFIX: &str = "jbeside_";
const PATIENCE: Duration = Duration::from_secs(180);

/// The program's own service, in iceoryx2's default domain.
struct Own {
    publisher: OwnPublisher<ipc::Service, u64, ()>,
    subscriber: OwnSubscriber<ipc::Service, u64, ()>,
    _node: Node<ipc::Service>,
}

impl Own {
    fn open() -> Done<Self> {
        let node = NodeBuilder::new().create::<ipc::Service>()?;
        let name = format!("joulebus-beside-{}", id());
        let service = node.service_builder(&name.as_str().try_into()?);
        let service = service.publish_subscribe::<u64>().open_or_create()?;
        Ok(Self {
            publisher: service.publisher_builder().create()?,
            subscriber: service.subscriber_builder().create()?,
            _node: node,
        })
    }

    fn exchange(&self, number: u64) -> Done {
        self.publisher.send_copy(number)?;
        let received = self.subscriber.receive()?.map(|sample| *sample);
        assert_eq!(received, Some(number));
        Ok(())
    }
}

struct Fleet {
    config: PathBuf,
    worker: Child,
    publisher: Publisher,
    planner: Subscriber,
    robot: u32,
}

impl Fleet {
    fn start(joulebus: &str, root: &Path, robot: u32) -> Done<Self> {
        let config = root.with_extension(format!("{robot}.toml"));
        let text = format!(
            "[fleet]\nname = \"fleet{robot}\"\ncapacity = 10\n\
             [domain]\nroot = \"{}\"\nprefix = \"{PREFIX}\"\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n",
            root.display()
        );
        fs::write(&config, text)?;
        Ok(Self {
            worker: work(joulebus, &config)?,
            publisher: Publisher::connect(&config, "controller")?,
            planner: Subscriber::connect(&config)?,
            config,
            robot,
        })
    }

    /// Publishes until a forecast arrives.
    fn forecast(&mut self) -> Done {
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            let robot = RobotState::new(self.robot).command(0.2, 0.0).reading(4.6);
            self.publisher.publish([robot])?;
            if let Event::Frame(frame) = self.planner.wait_next(Duration::from_millis(50))? {
                let (other, frame) = (3 - self.robot, frame);
                assert!(frame.robot(other).is_none(), "a robot of the other fleet");
                if frame.robot(self.robot).is_some() {
                    return Ok(());
                }
            }
        }
        Err("no forecast".into())
    }

    fn restart(&mut self, joulebus: &str) -> Done {
        self.worker.kill()?;
        self.worker.wait()?;
        self.worker = work(joulebus, &self.config)?;
        // What the killed worker sent is not what the next one forecasts.
        while let Event::Frame(_) = self.planner.wait_next(Duration::ZERO)? {}
        Ok(())
    }

    fn end(mut self) -> Done {
        self.worker.kill()?;
        self.worker.wait()?;
        Ok(fs::remove_file(&self.config)?)
    }
}

fn work(joulebus: &str, config: &Path) -> Done<Child> {
    let mut command = Command::new(joulebus);
    Ok(command.args(["run", "--config"]).arg(config).spawn()?)
}

fn main() -> Done {
    let joulebus = env::args()
        .nth(1)
        .ok_or("the path of joulebus is missing")?;
    let own = Own::open()?;
    own.exchange(1)?;
    let root = PathBuf::from(format!("/dev/shm/joulebus-beside-{}", id()));
    let mut fleets = [
        Fleet::start(&joulebus, &root, 1)?,
        Fleet::start(&joulebus, &root, 2)?,
    ];
    own.exchange(2)?;
    for fleet in &mut fleets {
        fleet.forecast()?;
    }
    fleets[0].restart(&joulebus)?;
    own.exchange(3)?;
    for fleet in &mut fleets {
        fleet.forecast()?;
    }
    for fleet in fleets {
        fleet.end()?;
        own.exchange(4)?;
    }
    let name = root.file_name().unwrap_or_default().to_owned();
    let left = fs::read_dir("/dev/shm")?
        .flatten()
        .map(|entry| entry.file_name());
    let is_ours =
        |found: &std::ffi::OsString| *found == name || found.to_string_lossy().starts_with(PREFIX);
    let left: Vec<_> = left.filter(is_ours).collect();
    assert!(left.is_empty(), "left behind: {left:?}");
    Ok(())
}
