//! Zip archives whose members are stored without compression: all that `.npz` needs.

/// Signatures of a member, of its entry in the directory, and of the end.
const MEMBER: u32 = 0x0403_4b50;
const ENTRY: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
/// Version of the format that is needed to read: 1.0.
const VERSION: u16 = 10;
/// 1 January 1980, the earliest date: the same members give the same bytes.
const DATE: u16 = 1 << 5 | 1;
/// The polynomial of the checksum, bits reversed.
const POLYNOMIAL: u32 = 0xedb8_8320;

/// An archive of these members: names and bytes. Of a network: far less than 4 GB, so all sizes
/// fit.
pub(super) fn archive(members: &[(String, Vec<u8>)]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, contents) in members {
        let place = bytes.len() as u32;
        let mut about = Vec::new();
        // No flags, no compression, midnight.
        for word in [VERSION, 0, 0, 0, DATE] {
            about.extend(word.to_le_bytes());
        }
        let size = contents.len() as u32;
        for word in [checksum(contents), size, size] {
            about.extend(word.to_le_bytes());
        }
        // Lengths of the name and of extra fields.
        for word in [name.len() as u16, 0] {
            about.extend(word.to_le_bytes());
        }
        bytes.extend(MEMBER.to_le_bytes());
        bytes.extend(&about);
        bytes.extend(name.bytes());
        bytes.extend(contents);
        directory.extend(ENTRY.to_le_bytes());
        directory.extend(VERSION.to_le_bytes());
        directory.extend(&about);
        // No comment, first disk, no attributes.
        directory.extend([0; 10]);
        directory.extend(place.to_le_bytes());
        directory.extend(name.bytes());
    }
    let (place, size, count) = (bytes.len() as u32, directory.len() as u32, members.len() as u16);
    bytes.extend(directory);
    bytes.extend(END.to_le_bytes());
    for word in [0, 0, count, count] {
        bytes.extend(word.to_le_bytes());
    }
    for word in [size, place] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend([0; 2]);
    bytes
}

/// CRC-32 of zip.
fn checksum(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| {
            if sum & 1 == 1 { sum >> 1 ^ POLYNOMIAL } else { sum >> 1 }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::checksum;

    #[test]
    fn the_checksum_is_that_of_zip() {
        assert_eq!(checksum(b"123456789"), 0xcbf4_3926);
        assert_eq!(checksum(b""), 0);
    }
}
