//! Numbers that are written once and read in order: in memory, and beyond that in a temporary file.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::ops::Range;
use std::os::unix::fs::FileExt as _;

/// Numbers in memory before they go to the file: 8 MB.
const MAX_IN_MEMORY: usize = 1 << 21;
/// Numbers that are read at a time.
const READ_AT_ONCE: usize = 1 << 14;

/// Many numbers. The file has no name: it is gone with the process.
#[derive(Debug)]
pub(super) struct Kept {
    max_in_memory: usize,
    file: Option<File>,
    /// Numbers in the file. Those in memory follow.
    in_file: u64,
    memory: Vec<f32>,
}

impl Default for Kept {
    fn default() -> Self {
        Self { max_in_memory: MAX_IN_MEMORY, file: None, in_file: 0, memory: Vec::new() }
    }
}

impl Kept {
    /// Keeps some numbers. Returns their position.
    pub(super) fn push(&mut self, numbers: &[f32]) -> io::Result<Range<u64>> {
        let start = self.in_file + self.memory.len() as u64;
        self.memory.extend_from_slice(numbers);
        if self.memory.len() > self.max_in_memory {
            self.spill()?;
        }
        Ok(start..start + numbers.len() as u64)
    }

    fn spill(&mut self) -> io::Result<()> {
        let file = match self.file.take() {
            Some(file) => file,
            None => tempfile::tempfile()?,
        };
        let mut out = BufWriter::new(&file);
        for number in &self.memory {
            out.write_all(&number.to_ne_bytes())?;
        }
        out.flush()?;
        drop(out);
        self.file = Some(file);
        self.in_file += self.memory.len() as u64;
        self.memory.clear();
        Ok(())
    }

    /// Calls `take` with each number of a range, in order.
    pub(super) fn each(&self, range: &Range<u64>, take: &mut dyn FnMut(f32)) -> io::Result<()> {
        const BYTES: usize = size_of::<f32>();
        let mut bytes = vec![0; READ_AT_ONCE * BYTES];
        let mut at = range.start;
        while let Some(file) = self.file.as_ref().filter(|_| at < range.end.min(self.in_file)) {
            let left = range.end.min(self.in_file) - at;
            let count = usize::try_from(left).map_or(READ_AT_ONCE, |left| left.min(READ_AT_ONCE));
            let bytes = &mut bytes[..count * BYTES];
            file.read_exact_at(bytes, at * BYTES as u64)?;
            let (numbers, _) = bytes.as_chunks::<BYTES>();
            numbers.iter().for_each(|bytes| take(f32::from_ne_bytes(*bytes)));
            at += count as u64;
        }
        let [from, to] = [at, range.end].map(|place| place.saturating_sub(self.in_file) as usize);
        let rest = self.memory.get(from..to).unwrap_or_default();
        rest.iter().for_each(|number| take(*number));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{Kept, READ_AT_ONCE};

    #[test]
    fn numbers_are_read_as_they_were_kept_wherever_they_are() {
        for max_in_memory in [0, 3, 1_000, 10 * READ_AT_ONCE] {
            let mut kept = Kept { max_in_memory, ..Kept::default() };
            let lists: Vec<Vec<f32>> = [0, 1, 5, 0, READ_AT_ONCE + 3, 2, 3 * READ_AT_ONCE, 1]
                .map(|count| (0..count).map(|n| n as f32 * 0.5 - 7.0).collect())
                .to_vec();
            let ranges: Vec<_> = lists.iter().map(|list| kept.push(list).unwrap()).collect();
            for (list, range) in lists.iter().zip(&ranges) {
                let mut found = Vec::new();
                kept.each(range, &mut |number| found.push(number)).unwrap();
                assert_eq!(&found, list);
            }
        }
    }
}
