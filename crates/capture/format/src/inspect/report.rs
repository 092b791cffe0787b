//! Result of an inspection, and its text.

use std::fmt;

use serde::Serialize;

use super::channel::{ChannelReport, Sequence};
use super::finding::{Finding, Severity};
use super::records::{AttachmentReport, CompressionReport, MetadataReport, SchemaReport};

/// Contents of a file.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Inspection {
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Profile in its header.
    pub profile: String,
    /// The library that wrote it, as stated.
    pub library: String,
    /// True if it could be read completely.
    pub complete: bool,
    /// Messages.
    pub messages: u64,
    /// Log time of the earliest message, ns.
    pub start_ns: Option<u64>,
    /// Log time of the latest message, ns.
    pub end_ns: Option<u64>,
    /// From the earliest to the latest, s.
    pub duration_s: Option<f64>,
    /// Messages whose log time is before that of an earlier message in the file.
    pub out_of_order: u64,
    /// Its chunks by compression.
    pub chunks: Vec<CompressionReport>,
    /// Messages outside of chunks.
    pub messages_outside_chunks: u64,
    /// Its schemas by id.
    pub schemas: Vec<SchemaReport>,
    /// Its channels by id.
    pub channels: Vec<ChannelReport>,
    /// Attachments.
    pub attachment_count: u64,
    /// The first attachments.
    pub attachments: Vec<AttachmentReport>,
    /// Metadata records.
    pub metadata_count: u64,
    /// The first metadata records.
    pub metadata: Vec<MetadataReport>,
    /// Number of errors.
    pub errors: u64,
    /// Number of notes.
    pub notes: u64,
    /// The first findings, in the order of the file.
    pub findings: Vec<Finding>,
}

impl Inspection {
    /// True if there are no errors.
    pub fn is_sound(&self) -> bool {
        self.errors == 0
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let severity = match self.severity {
            Severity::Error => "ERROR",
            Severity::Note => "note ",
        };
        match self.place {
            Some(place) => write!(out, "{severity}  {place}: {}", self.what),
            None => write!(out, "{severity}  {}", self.what),
        }
    }
}

impl fmt::Display for Inspection {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_head(out)?;
        self.write_channels(out)?;
        self.write_records(out)?;
        let s = |count: u64| if count == 1 { "" } else { "s" };
        let (errors, notes) = (self.errors, self.notes);
        writeln!(out, "findings     {errors} error{}, {notes} note{}", s(errors), s(notes))
    }
}

impl Inspection {
    fn write_head(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = if self.complete { "complete" } else { "INCOMPLETE or damaged" };
        writeln!(out, "size         {} bytes, {state}", self.bytes)?;
        writeln!(out, "written by   {} (profile {:?})", self.library, self.profile)?;
        if let (Some(start), Some(end), Some(duration)) =
            (self.start_ns, self.end_ns, self.duration_s)
        {
            writeln!(out, "log time     {} to {} s, {duration:.3} s", stamp(start), stamp(end))?;
        }
        write!(out, "messages     {}", self.messages)?;
        if self.messages_outside_chunks > 0 {
            write!(out, ", {} outside of chunks", self.messages_outside_chunks)?;
        }
        if self.out_of_order > 0 {
            write!(out, ", {} out of order", self.out_of_order)?;
        }
        writeln!(out)?;
        for chunks in &self.chunks {
            let name = match chunks.compression.as_str() {
                "" => "uncompressed",
                name => name,
            };
            write!(
                out,
                "chunks       {} {name}, {} bytes for {} of records",
                chunks.chunks, chunks.compressed_bytes, chunks.uncompressed_bytes
            )?;
            if chunks.unchecked > 0 {
                write!(out, ", {} without a checksum", chunks.unchecked)?;
            }
            writeln!(out)?;
        }
        Ok(())
    }

    fn write_channels(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "channels     {}, schemas {}", self.channels.len(), self.schemas.len())?;
        for channel in &self.channels {
            writeln!(out, "  {channel}")?;
        }
        Ok(())
    }

    fn write_records(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.attachment_count > 0 {
            writeln!(out, "attachments  {}", self.attachment_count)?;
        }
        for attachment in &self.attachments {
            let (name, media, bytes) = (&attachment.name, &attachment.media_type, attachment.bytes);
            writeln!(out, "  {name} ({media}), {bytes} bytes")?;
        }
        if self.metadata_count > 0 {
            writeln!(out, "metadata     {}", self.metadata_count)?;
        }
        for metadata in &self.metadata {
            let keys: Vec<&str> = metadata.entries.keys().map(String::as_str).collect();
            writeln!(out, "  {}: {}", metadata.name, keys.join(", "))?;
        }
        Ok(())
    }
}

impl fmt::Display for ChannelReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let schema = self.schema.as_deref().unwrap_or("no schema");
        write!(out, "{:<3} {:<36} {:>8} messages", self.id, self.topic, self.messages)?;
        if let Some(rate) = self.rate_hz {
            write!(out, " {rate:>8.2} Hz")?;
        }
        write!(out, "  {} {schema}", self.message_encoding)?;
        if self.gaps > 0 {
            let longest = self.longest_step_s.unwrap_or_default();
            write!(out, "; {} gaps, longest step {longest:.3} s", self.gaps)?;
        }
        if let (Some(least), Some(longest)) = (self.least_delay_s, self.longest_delay_s)
            && (least != 0.0 || longest != 0.0)
        {
            write!(out, "; logged {:.1} to {:.1} ms after publishing", 1e3 * least, 1e3 * longest)?;
        }
        if let Sequence::Counted { missing, restarts } = self.sequence
            && missing + restarts > 0
        {
            write!(out, "; {missing} missing by number, {restarts} restarts")?;
        }
        Ok(())
    }
}

/// Seconds with all nine decimals of a time in ns.
fn stamp(ns: u64) -> String {
    format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}
