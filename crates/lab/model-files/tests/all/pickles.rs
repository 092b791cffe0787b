//! Row 13: a pickle that would execute code is refused before anything is executed, in any
//! container; and no claimed size causes an allocation.

use std::io::{Cursor, Write as _};
use std::path::Path;

use crate::wrapped::{in_legacy, in_npy, in_zip, zipped};
use joulebus_model_files::{Checkpoint, Container, EntryValue, ReadError};
use joulebus_testkit::{assert_contains, counting};
use zip::write::SimpleFileOptions;

fn everywhere(pickle: &[u8]) -> Vec<Vec<u8>> {
    let mut files = vec![in_npy(pickle), in_zip(pickle)];
    files.extend(in_legacy(pickle));
    files
}

/// The attempt, the pickle, and what the refusal must contain.
fn attempts(canary: &str) -> Vec<(&'static str, Vec<u8>, &'static [&'static str])> {
    let command = format!("touch {canary}");
    let text = |text: &str| {
        let mut bytes = vec![b'X'];
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text.bytes());
        bytes
    };
    let call = |global: &str, argument: &str| {
        [b"\x80\x02", global.as_bytes(), &text(argument), b"\x85R."].concat()
    };
    let python = format!("open({canary:?}, 'w')");
    vec![
        (
            "os.system by GLOBAL and REDUCE",
            call("cposix\nsystem\n", &command),
            &["posix.system", "nothing was run"],
        ),
        (
            "os.system by STACK_GLOBAL",
            [b"\x80\x04\x8c\x02os\x94\x8c\x06system\x94\x93", &*text(&command), b"\x85R."].concat(),
            &["os.system", "nothing was run"],
        ),
        (
            "builtins.eval",
            call("cbuiltins\neval\n", &python),
            &["builtins.eval", "nothing was run"],
        ),
        (
            "builtins.exec under its old name",
            call("c__builtin__\nexec\n", &python),
            &["__builtin__.exec"],
        ),
        (
            "subprocess.Popen by NEWOBJ",
            [b"\x80\x02csubprocess\nPopen\n", &*text(&command), b"\x85\x81."].concat(),
            &["subprocess.Popen"],
        ),
        (
            "a known module's other function",
            call("ctorch._utils\n_import_dotted_name\n", "os.system"),
            &["torch._utils._import_dotted_name"],
        ),
        (
            "torch.load within a file",
            call("ctorch\nload\n", canary),
            &["torch.load"],
        ),
        (
            "a dotted name, which Python would resolve",
            b"\x80\x04\x8c\x05numpy\x94\x8c\x0edtype.__init__\x94\x93.".to_vec(),
            &["numpy.dtype.__init__"],
        ),
        (
            "a layer that is not known",
            b"\x80\x02ctorch.nn.modules.module\nModule\n)\x81.".to_vec(),
            &["torch.nn.modules.module.Module"],
        ),
        (
            "BUILD of an object with __setstate__",
            [b"\x80\x02c__main__\nModel\n)\x81}X\x0c\x00\x00\x00__setstate__N", &b"sb."[..]].concat(),
            &["__main__.Model", "state_dict"],
        ),
        (
            "BUILD of a number",
            b"\x80\x02K\x01}b.".to_vec(),
            &["BUILD", "a dict to an integer"],
        ),
        (
            "REDUCE of a text",
            [b"\x80\x02", &*text("os.system"), &text(&command), b"\x85R."].concat(),
            &["REDUCE", "calls text"],
        ),
        (
            "_codecs.encode with another codec",
            [b"\x80\x02c_codecs\nencode\n", &*text("x"), &text("rot13"), b"\x86R."].concat(),
            &["_codecs.encode", "rot13"],
        ),
        (
            "an array made of another class",
            b"\x80\x02cnumpy.core.multiarray\n_reconstruct\nccollections\nOrderedDict\nK\x00\x85C\x01b\x87R."
                .to_vec(),
            &["numpy's array", "numpy.ndarray"],
        ),
        ("INST", b"\x80\x02(S'x'\nios\nsystem\n.".to_vec(), &["STRING", "0x53"]),
        ("OBJ", b"\x80\x02(N\x85o.".to_vec(), &["OBJ"]),
        ("protocol 0", format!("cos\nsystem\n(S'{command}'\ntR.").into_bytes(), &["os.system"]),
        ("EXT1", b"\x80\x02\x82\x01.".to_vec(), &["EXT1", "0x82"]),
        ("EXT2", b"\x80\x02\x83\x01\x00.".to_vec(), &["EXT2"]),
        ("EXT4", b"\x80\x02\x84\x01\x00\x00\x00.".to_vec(), &["EXT4"]),
        ("PERSID", b"\x80\x02Pos.system\n.".to_vec(), &["PERSID", "0x50"]),
        (
            "BINPERSID of something else",
            [b"\x80\x02", &*text("os.system"), b"Q."].concat(),
            &["BINPERSID"],
        ),
        (
            "NEWOBJ_EX",
            b"\x80\x04cbuiltins\nset\n)}\x92.".to_vec(),
            &["NEWOBJ_EX"],
        ),
        ("NEXT_BUFFER", b"\x80\x05\x97.".to_vec(), &["NEXT_BUFFER"]),
        ("an opcode that does not exist", b"\x80\x02\xff.".to_vec(), &["unknown", "0xff"]),
        ("a future protocol", b"\x80\x06N.".to_vec(), &["protocol 6"]),
    ]
}

#[test]
fn a_pickle_that_would_execute_code_is_refused_with_name_and_location() {
    let folder = tempfile::tempdir().unwrap();
    let canary = folder.path().join("canary");
    let mut refused = 0;
    for (what, pickle, parts) in attempts(canary.to_str().unwrap()) {
        for file in everywhere(&pickle) {
            let error = Checkpoint::read(&file).unwrap_err();
            let words = error.to_string();
            assert!(matches!(error, ReadError::Pickle { .. }), "{what}: {words}");
            assert!(words.contains("byte "), "{what}: {words}");
            for part in parts {
                assert!(words.contains(part), "{what}: {words}");
            }
            refused += 1;
        }
    }
    assert!(!Path::new(&canary).exists());
    println!("figure: {refused} malicious pickles, 0 accepted, canary untouched");
}

#[test]
fn harmless_pickles_in_the_same_containers_are_read() {
    let pickle = b"\x80\x02}q\x00X\x01\x00\x00\x00aq\x01K\x07s.";
    let [legacy, _] = in_legacy(pickle);
    for file in [in_npy(pickle), in_zip(pickle), legacy] {
        let read = Checkpoint::read(&file).unwrap();
        assert_eq!(read.entries.len(), 1);
        assert_eq!(read.entries[0].path, "a");
    }
}

#[test]
fn foreign_objects_are_opaque_where_no_network_can_be_and_refused_where_one_could() {
    let text =
        |text: &str| [&b"X"[..], &(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    // {"a": 7, "path": OBJECT}
    let beside = |object: &[u8]| {
        let items =
            [b"\x80\x02}(".to_vec(), text("a"), b"K\x07".to_vec(), text("path"), object.to_vec()];
        [items.concat(), b"u.".to_vec()].concat()
    };
    let path = [&b"cpathlib\nPurePosixPath\n"[..], &text("logs"), b"\x85R"].concat();
    let namespace = [&b"cargparse\nNamespace\n)\x81}"[..], &text("lr"), b"K\x01sb"].concat();
    let command = [&b"cposix\nsystem\n"[..], &text("touch canary"), b"\x85R"].concat();
    let dtype = b"ctorch\nfloat32\n".to_vec();
    let items = b"ccollections\nCounter\n)\x81(K\x01K\x02u".to_vec();
    for object in [&path, &namespace, &command, &dtype, &items] {
        for file in [in_npy(&beside(object)), in_zip(&beside(object)), beside(object)] {
            let read = Checkpoint::read(&file).unwrap();
            let paths: Vec<&str> = read.entries.iter().map(|entry| &*entry.path).collect();
            assert_eq!(paths, ["a", "path"]);
            let foreign = matches!(read.entries[1].value, EntryValue::Other(what) if what.contains("foreign"));
            assert!(foreign, "{:?}", read.entries[1]);
        }
    }
    // With an array or a layer in it, or in its arguments, or in its state.
    let array = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01K\x01\x85\
        cnumpy\ndtype\nX\x02\x00\x00\x00f8K\x00K\x01\x87R(K\x03X\x01\x00\x00\x00<NNNtb\x89C\x08\x00\x00\x00\x00\x00\x00\x00\x00tb";
    let layer = b"ctorch.nn.modules.linear\nLinear\n)\x81";
    for inner in [&array[..], layer] {
        let of = |before: &[u8], after: &[u8]| [before, inner, after].concat();
        for object in [
            of(b"c__main__\nModel\n", b"\x85R"),
            of(b"c__main__\nModel\n)\x81}K\x01", b"sb"),
            of(b"c__main__\nModel\n)\x81K\x01", b"s"),
            of(b"c__main__\nOuter\nc__main__\nModel\n", b"\x85R\x85R"),
        ] {
            let error = Checkpoint::read(&in_npy(&beside(&object))).unwrap_err().to_string();
            assert_contains(&error, ["__main__.", "nothing was run", "\"path\""]);
        }
    }
    // Objects that hold themselves a million times take no time and no memory.
    let within = [&b"c__main__\nA\n)\x81q\x00("[..], &b"h\x00".repeat(50_000), b"e"].concat();
    let error = Checkpoint::read(&in_npy(&beside(&within))).unwrap_err().to_string();
    assert!(error.contains("more entries") || error.contains("nested deeper"), "{error}");
}

#[test]
fn a_bare_pickle_of_arrays_is_read() {
    let array = b"\x80\x02}X\x01\x00\x00\x00w](K\x01K\x02es.";
    let read = Checkpoint::read(array).unwrap();
    assert_eq!((read.container, read.entries.len()), (Container::Pickle, 1));
    let error =
        Checkpoint::read(b"\x80\x04\x8c\x07sklearn\x8c\x03MLP\x93)\x81.").unwrap_err().to_string();
    assert_contains(&error, ["sklearn.MLP", "state_dict"]);
}

#[test]
fn archives_of_other_programs_are_named() {
    for (members, expected_text) in [
        (&["config.json", "model.weights.h5"][..], "numpy.savez"),
        (
            &["m/archive_format", "m/models/model.json", "m/data/weights/weight_0"],
            "torch.export.load",
        ),
        (&["notes.txt"], "a zip archive with \"notes.txt\""),
    ] {
        let members: Vec<(&str, &[u8])> = members.iter().map(|name| (*name, &b"{}"[..])).collect();
        let error = Checkpoint::read(&zipped(&members)).unwrap_err();
        assert!(matches!(error, ReadError::Kind { .. }), "{error}");
        assert_contains(&error.to_string(), [expected_text]);
    }
}

#[test]
fn a_name_from_the_file_is_escaped_for_terminals() {
    let error = Checkpoint::read(&in_npy(b"\x80\x02c\x1b]0;x\x07\nsystem\n.")).unwrap_err();
    assert!(!error.to_string().contains(char::is_control), "{error}");
}

/// The claim, the pickle, and what the refusal must contain.
fn claims() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let tensor = |shape: &[u8], strides: &[u8], offset: u8| {
        let storage = b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x04tQ";
        let mut bytes = b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(".to_vec();
        bytes.extend(storage);
        bytes.extend([b'K', offset]);
        bytes.extend(shape);
        bytes.extend(strides);
        bytes.extend(b"\x89}tR.");
        bytes
    };
    let array = |shape: &[u8]| {
        let mut bytes = b"\x80\x03cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01".to_vec();
        bytes.extend(shape);
        bytes.extend(b"cnumpy\ndtype\nX\x02\x00\x00\x00f8K\x00K\x01\x87R(K\x03X\x01\x00\x00\x00<NNNtb\x89C\x08\x00\x00\x00\x00\x00\x00\x00\x00tb.");
        bytes
    };
    let huge = b"J\xff\xff\xff\x7f";
    let pair: Vec<u8> = [&huge[..], huge, b"\x86"].concat();
    let nested = [&b"\x80\x02"[..], &vec![b']'; 5_000], &vec![b'a'; 4_999], b"."].concat();
    // Each list holds the one before it ten times: 10^12 values in all.
    let mut laughs = b"\x80\x02]q\x00".to_vec();
    for level in 0..12_u8 {
        laughs.extend(b"](");
        laughs.extend([b'h', level].repeat(10));
        laughs.extend([b'e', b'q', level + 1]);
    }
    laughs.extend(b"\x86");
    for _ in 0..11 {
        laughs.extend(b"\x86");
    }
    laughs.push(b'.');
    vec![
        ("text of 4 GB", b"\x80\x02X\xff\xff\xff\xff".to_vec(), "needs 4294967295 bytes"),
        (
            "bytes of 16 EB",
            b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\xff".to_vec(),
            "needs 18446744073709551615 bytes",
        ),
        (
            "a frame that is too long",
            b"\x80\x04\x95\x99\x00\x00\x00\x00\x00\x00\x00N.".to_vec(),
            "FRAME",
        ),
        ("an array larger than its bytes", array(&pair), "8 bytes of contents"),
        (
            "a shape whose product wraps around",
            array(&[&b"("[..], &huge.repeat(5), b"t"].concat()),
            "impossible shape",
        ),
        ("a view larger than its storage", tensor(&pair, &pair, 0), "no part of a storage"),
        ("a view without strides", tensor(&pair, b"K\x00K\x00\x86", 0), "no part of a storage"),
        ("a view past the end", tensor(b"K\x02\x85", b"K\x02\x85", 2), "no part of a storage"),
        ("lists nested five thousand deep", nested, "nested deeper than"),
        ("a billion laughs", laughs, ""),
        ("a list in itself", b"\x80\x02]q\x00h\x00a.".to_vec(), "nested deeper than"),
        ("an entry that was never stored", b"\x80\x02h\x07.".to_vec(), "entry 7"),
        ("an empty stack", b"\x80\x02.".to_vec(), "STOP"),
        ("no MARK", b"\x80\x02t.".to_vec(), "no MARK"),
        ("a key without a value", b"\x80\x02}(Nu.".to_vec(), "key without a value"),
        ("values left over", b"\x80\x02NN.".to_vec(), "values over"),
        (
            "a hundred thousand values",
            [&b"\x80\x02("[..], &vec![b'N'; 200_000], b"t."].concat(),
            "100000 values",
        ),
        ("no end", b"\x80\x02N".to_vec(), "needs 1 bytes, 0 are left"),
    ]
}

#[test]
fn claimed_sizes_cause_neither_allocation_nor_recursion() {
    for (what, pickle, part) in claims() {
        let [legacy, _] = in_legacy(&pickle);
        for file in [in_npy(&pickle), in_zip(&pickle), legacy] {
            let before = counting::bytes();
            let error = Checkpoint::read(&file).expect_err(what).to_string();
            let allocated = counting::bytes() - before;
            // A NumPy file has no storages, so BINPERSID itself is refused.
            let expected = error.contains(part) || error.contains("BINPERSID");
            assert!(expected, "{what}: {error}");
            // Growing vectors are counted each time; the largest file here has 200 kB.
            assert!(allocated < 40 << 20, "{what}: {allocated} bytes allocated");
        }
    }
}

#[test]
fn a_claimed_number_of_members_causes_no_allocation() {
    let archive = in_zip(b"\x80\x02N.");
    let end = archive.windows(4).rposition(|window| window == b"PK\x05\x06").unwrap();
    let mut many = archive.clone();
    many[end + 8..end + 12].copy_from_slice(&[0xfe; 4]);
    // The ZIP64 record, and its locator.
    let mut huge = archive[..end].to_vec();
    let at = huge.len() as u64;
    huge.extend(b"PK\x06\x06");
    huge.extend(44_u64.to_le_bytes());
    huge.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for value in [u64::MAX / 512, u64::MAX / 512, u64::MAX / 2, u64::MAX / 2] {
        huge.extend(value.to_le_bytes());
    }
    huge.extend(b"PK\x06\x07\0\0\0\0");
    huge.extend(at.to_le_bytes());
    huge.extend(1_u32.to_le_bytes());
    huge.extend(b"PK\x05\x06\0\0\0\0");
    huge.extend([0xff; 12]);
    huge.extend([0, 0]);
    for file in [many, huge] {
        let before = counting::bytes();
        let error = Checkpoint::read(&file).unwrap_err().to_string();
        let allocated = counting::bytes() - before;
        assert!(error.contains("members, allowed") || error.contains("directory"), "{error}");
        assert!(allocated < 1 << 20, "{allocated} bytes allocated");
    }
}

#[test]
fn a_member_that_decompresses_to_far_more_than_its_size_is_refused() {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    archive.start_file("bomb.npy", SimpleFileOptions::default()).unwrap();
    for _ in 0..40 {
        archive.write_all(&vec![0; 1 << 20]).unwrap();
    }
    let file = archive.finish().unwrap().into_inner();
    assert!(file.len() < 1 << 20);
    let error = Checkpoint::read(&file).unwrap_err().to_string();
    assert_contains(&error, ["bomb.npy", "more than"]);
}
