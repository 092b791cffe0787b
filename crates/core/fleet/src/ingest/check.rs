//! Checks of a sample of a known robot, in the order of their execution.

use joulebus_wire::{DropReason, InvalidReason, SampleHeader};

use crate::ingest::admission::AdmissionState;

/// Checks that the source owns the robot, and that its numbers rise. A robot whose owner has ended
/// (`is_free`) becomes this source's, as with another run of the same source. The frame belongs to
/// its source's present run: another one than the robot's has taken over.
pub(crate) fn sender(
    admission: &mut AdmissionState,
    header: &SampleHeader,
    seq: u64,
    is_free: impl FnOnce(u64) -> bool,
) -> Result<(), DropReason> {
    let is_owner = admission.source_id == header.source_id;
    if !is_owner && !is_free(admission.source_id) {
        return Err(DropReason::ForeignSource);
    }
    if !is_owner || header.source_epoch != admission.source_epoch {
        admission.source_id = header.source_id;
        (admission.source_epoch, admission.ordered, admission.renewed) =
            (header.source_epoch, false, true);
    }
    if admission.ordered && seq <= admission.seq {
        return Err(if seq == admission.seq {
            DropReason::Duplicate
        } else {
            DropReason::OutOfOrder
        });
    }
    (admission.seq, admission.ordered) = (seq, true);
    Ok(())
}

/// Refuses samples beyond `most` per robot and tick.
pub(crate) fn backlog(admission: &AdmissionState, most: u16) -> Result<(), DropReason> {
    if admission.taken >= most {
        return Err(DropReason::Backlog);
    }
    Ok(())
}

/// Refuses a stamp that is not after the robot's last one, or more than `max_jump_ns` after it. For
/// the first sample of a new run this only breaks the sequence.
pub(crate) fn time(
    admission: &AdmissionState,
    stamp_ns: u64,
    max_jump_ns: u64,
) -> Result<bool, DropReason> {
    let in_time = !admission.accepted
        || (stamp_ns > admission.stamp_ns && stamp_ns - admission.stamp_ns <= max_jump_ns);
    if !in_time && !admission.renewed {
        return Err(DropReason::BadTime);
    }
    Ok(!in_time)
}

/// The effect of a refused value on the robot. `None` if the robot is not affected.
pub(crate) fn invalid(reason: DropReason) -> Option<InvalidReason> {
    match reason {
        DropReason::NotFinite => Some(InvalidReason::NotFinite),
        DropReason::PowerOutOfRange => Some(InvalidReason::PowerOutOfRange),
        DropReason::CommandOutOfRange => Some(InvalidReason::CommandOutOfRange),
        DropReason::BadFlags => Some(InvalidReason::BadFlags),
        DropReason::BatteryOutOfRange => Some(InvalidReason::BatteryOutOfRange),
        DropReason::BadTime => Some(InvalidReason::BadTime),
        _ => None,
    }
}
