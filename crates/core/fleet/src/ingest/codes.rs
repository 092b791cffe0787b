//! Serialisation of `wire` types by their codes in shared memory.

/// The reason why a robot has no forecast, if any, as its code.
pub(crate) mod invalid_reason {
    use joulebus_wire::InvalidReason;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer};

    pub(crate) fn serialize<S: Serializer>(
        reason: &Option<InvalidReason>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        reason.map(InvalidReason::code).serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<InvalidReason>, D::Error> {
        Ok(Option::deserialize(from)?.map(InvalidReason::decode))
    }
}

pub(crate) mod drop_counts {
    use joulebus_wire::DropCounts;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer};

    pub(crate) fn serialize<S: Serializer>(drops: &DropCounts, to: S) -> Result<S::Ok, S::Error> {
        drops.counts.serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<DropCounts, D::Error> {
        Ok(DropCounts { counts: <[u64; 24]>::deserialize(from)? })
    }
}

/// The list of refused robots.
pub(crate) mod refusals {
    use joulebus_wire::Refusal;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer};

    pub(crate) fn serialize<S: Serializer>(
        places: &[Refusal; 16],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let fields = |place: &Refusal| [place.robot, place.reason, place.pid, place.count];
        places.each_ref().map(fields).serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<[Refusal; 16], D::Error> {
        let places = <[[u32; 4]; 16]>::deserialize(from)?;
        Ok(places.map(|[robot, reason, pid, count]| Refusal { robot, reason, pid, count }))
    }
}
