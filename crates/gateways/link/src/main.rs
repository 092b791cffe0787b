//! The program of `joulebus link`.
//!
//! To its host's fleet a link is a source and a planner like any other. It exchanges their frames
//! with links on other hosts.
#![forbid(unsafe_code)]

mod arguments;
mod certificates;
mod config;
mod contact;
mod egress;
mod etcd;
mod follow;
mod forward;
mod ingress;
mod init;
mod intake;
mod leadership;
mod link;
mod network;
mod output_port;
mod outputs;
mod proof;
mod protocol;
mod refusals;
mod report;
mod rmw;
mod session;
mod shared;
mod standby;
mod threads;
mod tls_causes;
mod tls_workaround;
mod worker_ports;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::logging::tap(tls_causes::TAP);
    joulebus_program::verb::main("link", joulebus_bus::check_stack(), link::run)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    #[test]
    fn the_seed_of_the_fuzz_target_is_the_one_that_tests_take() {
        let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../fuzz/seeds/link");
        // A published crate has no fuzz targets beside it.
        if seeds.is_dir() {
            let kept = std::fs::read(seeds.join("good")).unwrap();
            assert_eq!(kept, crate::protocol::hostile::seed());
        }
    }
}
