//! The program of `joulebus serve`: a fleet's page, API and metrics.
#![forbid(unsafe_code)]

mod arguments;
mod http;
mod serve;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::verb::main("serve", joulebus_bus::check_stack(), serve::run)
}

#[cfg(test)]
mod tests {
    use clap::Args as _;

    use crate::arguments::ServeArguments;

    #[test]
    fn the_main_program_shows_these_options() {
        let verb = ServeArguments::augment_args(clap::Command::new("serve"));
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../cli/verbs/serve.json");
        joulebus_program::described::check(file.as_ref(), &[verb]);
    }
}
