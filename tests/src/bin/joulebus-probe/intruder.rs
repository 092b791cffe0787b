//! Attempts every file access open to another user, and reports which succeeded.

use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::Path;

use joulebus_bus::Bus;
use joulebus_config::Config;

use crate::{Done, print_line};

pub(crate) fn run(config: &Config) -> Done {
    let domain = config.domain()?;
    let mut worked: Vec<String> = Vec::new();
    let mut tried = 0;
    for entry in fs::read_dir("/dev/shm")?.flatten() {
        if !entry.file_name().to_string_lossy().starts_with(domain.shm_prefix()) {
            continue;
        }
        let path = entry.path();
        let mut attempt = |what: &str, worked_out: bool| {
            tried += 1;
            if worked_out {
                worked.push(format!("{what} {}", path.display()));
            }
        };
        attempt("read", fs::File::open(&path).is_ok());
        attempt("write", fs::OpenOptions::new().write(true).open(&path).is_ok());
        attempt("remove", fs::remove_file(&path).is_ok());
    }
    for directory in [domain.root().to_owned(), domain.directory()] {
        tried += 2;
        if fs::read_dir(&directory).is_ok() {
            worked.push(format!("list {}", directory.display()));
        }
        if fs::write(directory.join("intruder"), "x").is_ok() {
            worked.push(format!("write into {}", directory.display()));
        }
    }
    tried += 2;
    let socket = UnixDatagram::unbound()?;
    if socket.send_to(b"x", Path::new(&domain.directory()).join("members.lock")).is_ok() {
        worked.push("send".to_owned());
    }
    if Bus::join(&domain, "intruder").is_ok() {
        worked.push("join".to_owned());
    }
    print_line(&(tried, worked))
}
