//! The shards of a fleet that is split over several workers.

use joulebus_wire::fnv1a;

/// A set of robots with one leading worker at a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shard {
    pub(crate) name: String,
    /// Names of the links of its candidates: the worker and its standbys.
    pub(crate) workers: Vec<String>,
    /// First and last ids, sorted and disjoint, or none if hashing assigns the robots.
    pub(crate) robots: Vec<(u32, u32)>,
}

/// All shards, the same on every host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shards {
    all: Vec<Shard>,
    /// Hash of each shard's name, kept because every row of every frame looks up its robot.
    hashes: Vec<u64>,
    /// Hashing assigns the robots, not lists.
    is_hashed: bool,
    /// Digest of all fields above, sent in every message. Hosts with different shards refuse each
    /// other.
    digest: u32,
}

impl Shards {
    /// Creates the shards. Hashing assigns the robots if no shard lists any.
    pub(crate) fn new(all: Vec<Shard>) -> Self {
        let is_hashed = all.iter().all(|shard| shard.robots.is_empty());
        let mut text = String::new();
        for Shard { name, workers, robots } in &all {
            text.push_str(&format!("{name}={workers:?}{robots:?};"));
        }
        let hash = fnv1a(text.bytes());
        // 0 is reserved for a fleet without shards.
        let digest = ((hash >> 32) as u32 ^ hash as u32).max(1);
        let hashes = all.iter().map(|shard| fnv1a(shard.name.bytes()));
        Self { hashes: hashes.collect(), all, is_hashed, digest }
    }

    pub(crate) fn all(&self) -> &[Shard] {
        &self.all
    }

    pub(crate) const fn digest(&self) -> u32 {
        self.digest
    }

    /// The shard of a robot. `None` if no shard lists it.
    pub(crate) fn of_robot(&self, robot: u32) -> Option<usize> {
        if !self.is_hashed {
            let has = |shard: &Shard| {
                let robots = &shard.robots;
                let at = robots.partition_point(|(first, _)| *first <= robot);
                at > 0 && robot <= robots[at - 1].1
            };
            return self.all.iter().position(has);
        }
        // Rendezvous hashing: adding or removing a shard moves only robots of that shard.
        let robot = mixed(robot.into());
        let places = self.hashes.iter().enumerate();
        let heaviest = places.max_by_key(|(at, hash)| (mixed(*hash ^ robot), *at));
        heaviest.map(|(at, _)| at)
    }

    /// The shard for which the link of this name is a candidate.
    pub(crate) fn of_worker(&self, link: &str) -> Option<usize> {
        let is_candidate = |shard: &Shard| shard.workers.iter().any(|worker| worker == link);
        self.all.iter().position(is_candidate)
    }
}

/// Spreads a number over all bits (the finaliser of SplitMix64).
const fn mixed(mut bits: u64) -> u64 {
    bits = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shard(name: &str, robots: &[(u32, u32)]) -> Shard {
        Shard {
            name: name.to_owned(),
            workers: vec![format!("base-{name}")],
            robots: robots.to_vec(),
        }
    }

    #[test]
    fn lists_share_out_the_robots_that_they_name() {
        let shards =
            Shards::new(vec![shard("a", &[(0, 4), (8, 8)]), shard("b", &[(5, 7), (9, u32::MAX)])]);
        for (robot, place) in [(0, 0), (4, 0), (5, 1), (7, 1), (8, 0), (9, 1)] {
            assert_eq!(shards.of_robot(robot), Some(place), "{robot}");
        }
        assert_eq!(shards.of_robot(u32::MAX), Some(1));
        assert_eq!(Shards::new(vec![shard("a", &[(1, 2)])]).of_robot(3), None);
        assert_eq!(shards.of_worker("base-b"), Some(1));
        assert_eq!(shards.of_worker("b"), None);
    }

    #[test]
    fn hashing_shares_evenly_and_a_further_shard_takes_robots_only_for_itself() {
        let names = ["north", "south", "east", "west", "yard"];
        let of = |names: &[&str]| Shards::new(names.iter().map(|name| shard(name, &[])).collect());
        for count in 1..names.len() {
            let (before, after) = (of(&names[..count]), of(&names[..=count]));
            let mut has = vec![0_u32; count + 1];
            for robot in 0..10_000 {
                let (old, new) = (before.of_robot(robot), after.of_robot(robot).unwrap());
                assert!(Some(new) == old || new == count, "{robot}: {old:?} to {new}");
                has[new] += 1;
            }
            let even = 10_000.0 / has.len() as f64;
            for robots in &has {
                // Five standard deviations of the binomial.
                assert!((f64::from(*robots) - even).abs() < 5.0 * even.sqrt(), "{has:?}");
            }
        }
    }

    #[test]
    fn the_place_of_a_robot_is_the_same_in_every_release() {
        let shards = Shards::new(vec![shard("a", &[]), shard("b", &[]), shard("c", &[])]);
        let found: Vec<usize> = (0..12).filter_map(|robot| shards.of_robot(robot)).collect();
        assert_eq!(found, [1, 2, 2, 2, 1, 0, 0, 2, 2, 1, 1, 2]);
    }

    #[test]
    fn shards_that_differ_in_anything_have_other_digests() {
        let one = Shards::new(vec![shard("a", &[(0, 4)]), shard("b", &[(5, 9)])]);
        for other in [
            vec![shard("a", &[(0, 5)]), shard("b", &[(6, 9)])],
            vec![shard("b", &[(5, 9)]), shard("a", &[(0, 4)])],
            vec![shard("a", &[]), shard("b", &[])],
            vec![shard("a", &[(0, 4)])],
        ] {
            assert_ne!(one.digest(), Shards::new(other).digest());
        }
        assert_ne!(one.digest(), 0);
    }
}
