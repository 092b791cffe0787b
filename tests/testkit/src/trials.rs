//! Test files written byte by byte, without the crates that read them.

use std::io::Write;
use std::path::PathBuf;

use flate2::Compression;
use flate2::write::GzEncoder;
use tempfile::TempDir;

/// A directory of one test's files.
#[derive(Debug)]
pub struct Files(TempDir);

impl Files {
    /// An empty one.
    ///
    /// # Panics
    /// The folder cannot be made.
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a directory for temporary use"))
    }

    /// Writes a file, and returns its path.
    ///
    /// # Panics
    /// The file cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).expect("a file for temporary use");
        path
    }
}

impl Default for Files {
    fn default() -> Self {
        Self::new()
    }
}

/// A NumPy file with this description and these data, version 1.0.
pub fn npy(header: &str, data: &[u8]) -> Vec<u8> {
    let mut text = header.to_owned();
    while !(10 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(data);
    bytes
}

/// Rows in C order as a plain little-endian f8 array.
pub fn npy_f8(rows: &[[f64; 11]]) -> Vec<u8> {
    let data = rows.iter().flatten().flat_map(|value| value.to_le_bytes());
    npy(&header("<f8", "False", rows.len()), &data.collect::<Vec<_>>())
}

/// The header of a NumPy file of so many rows of eleven columns.
pub fn header(descr: &str, fortran: &str, rows: usize) -> String {
    format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': ({rows}, 11), }}")
}

/// The bytes, compressed.
///
/// # Panics
/// Never: it writes into memory.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// Rows in the order of the array layout, as the CSV of the recordings.
pub fn csv(rows: &[[f64; 11]]) -> String {
    let mut text = "robot_id,timestamp_s,phase,v_cmd_mps,omega_cmd_radps,x_m,y_m,theta_rad,\
                    voltage_mV,current_mA,power_mW\n"
        .to_owned();
    for row in rows {
        text += &row.map(|value| value.to_string()).join(",");
        text.push('\n');
    }
    text
}

const NAN: f64 = f64::NAN;

/// Five rows at 10 Hz: a held reading (row 2), a missing one (row 4), a pose that was not recorded.
pub const ROWS: [[f64; 11]; 5] = [
    [7.0, 100.0, 1.0, 0.1, 1.0, NAN, NAN, NAN, 7000.0, 500.0, 3500.0],
    [7.0, 100.1, 1.0, 0.2, -1.5, NAN, NAN, NAN, 7000.0, 500.0, 3500.0],
    [7.0, 100.2, 1.0, 0.3, 2.0, NAN, NAN, NAN, 7100.0, 500.0, 3550.0],
    [7.0, 100.3, 2.0, 0.4, -2.5, NAN, NAN, NAN, 7100.0, 500.0, NAN],
    [7.0, 100.4, 2.0, NAN, 3.0, NAN, NAN, NAN, 7200.0, 250.0, -1800.0],
];

/// Rows with only time (s) and power (mW).
pub fn timed(rows: &[(f64, f64)]) -> Vec<[f64; 11]> {
    rows.iter()
        .map(|(time_s, power_mw)| {
            let mut row = [NAN; 11];
            (row[1], row[10]) = (*time_s, *power_mw);
            row
        })
        .collect()
}
