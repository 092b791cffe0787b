//! FNV-1a, used for source ids, names in shared memory and fingerprints.

const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;

/// The 64-bit FNV-1a hash of `bytes`: stable across versions, machines and languages, unlike the
/// standard library's.
#[must_use]
pub fn fnv1a(bytes: impl IntoIterator<Item = u8>) -> u64 {
    let step = |hash, byte| step(hash, u64::from(byte));
    bytes.into_iter().fold(OFFSET_BASIS, step)
}

/// One hash of several: theirs if all are equal. Otherwise it depends on their order: FNV-1a over
/// whole 64-bit words, with a rotation that moves the upper bits down, because multiplication
/// propagates bits upwards only.
#[must_use]
pub fn combine_hashes(hashes: impl IntoIterator<Item = u64, IntoIter: Clone>) -> u64 {
    let hashes = hashes.into_iter();
    let combine = |combined, hash| step(combined, hash).rotate_left(23);
    match hashes.clone().next() {
        Some(first) if hashes.clone().all(|hash| hash == first) => first,
        _ => hashes.fold(OFFSET_BASIS, combine),
    }
}

const fn step(hash: u64, input: u64) -> u64 {
    (hash ^ input).wrapping_mul(PRIME)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_published_test_vectors() {
        for (text, hash) in [
            ("", 0xcbf2_9ce4_8422_2325),
            ("a", 0xaf63_dc4c_8601_ec8c),
            ("b", 0xaf63_df4c_8601_f1a5),
            ("fo", 0x0898_5907_b541_d342),
            ("foobar", 0x8594_4171_f739_67e8),
            ("chongo was here!\n", 0x4681_0940_eff5_f915),
            ("127.0.0.1", 0xaaba_fe71_04d9_14be),
        ] {
            assert_eq!(fnv1a(text.bytes()), hash, "{text:?}");
        }
    }

    #[test]
    fn combined_hashes_never_change_and_depend_on_their_order() {
        // Computed independently of this code: captures carry the combined hash of their models.
        assert_eq!(combine_hashes([1, 2]), 0x237b_819c_6a2d_c628);
        assert_eq!(combine_hashes([7, 7, 7]), 7);
        assert_ne!(combine_hashes([1, 2]), combine_hashes([2, 1]));
    }
}
