//! Ports for servers that must know theirs before they start.

use std::net::TcpListener;
use std::sync::Mutex;

/// Below the ports that the kernel gives to others (`ip_local_port_range`).
const PORTS: std::ops::Range<u16> = 20_000..32_000;
/// Another address of this host, where a port is reserved, so that [`free_port`]'s own stays free.
const RESERVED_AT: &str = "127.0.0.2";

/// A TCP port of 127.0.0.1 that nobody listens on, reserved for this process among the tests of
/// this host. A port that is only free could be another test's by the time of its use.
///
/// # Panics
/// All are taken.
pub fn free_port() -> u16 {
    static RESERVED: Mutex<Vec<TcpListener>> = Mutex::new(Vec::new());
    for port in PORTS {
        let Ok(reserved) = TcpListener::bind((RESERVED_AT, port)) else {
            continue;
        };
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            RESERVED.lock().expect("nobody panics with it").push(reserved);
            return port;
        }
    }
    panic!("no port of {PORTS:?} is free");
}
