//! Files of other programs, by their first bytes: what they are, and how they are converted.

use std::fmt;
use std::io::Read as _;
use std::path::Path;

/// Bytes at the beginning of a file that identify its kind.
pub const HEAD_BYTES: u64 = 512;

/// A kind of file that is not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreign {
    /// The kind of file, as in "found …".
    pub what: &'static str,
    /// Conversion to a file that is read.
    pub remedy: &'static str,
}

impl Foreign {
    /// The kind of file with a remedy, for readers of other contents than tables.
    pub fn of_any_contents(&self) -> String {
        match self.remedy.contains("csv") || self.remedy.contains("read_table") {
            true => self.what.to_owned(),
            false => self.to_string(),
        }
    }
}

impl fmt::Display for Foreign {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.what, self.remedy)
    }
}

/// Offset and bytes that identify a file, its kind, and its conversion. The first one applies.
type Kind = (usize, &'static [u8], &'static str, &'static str);

/// A file that captures and bags may be.
pub const MCAP: &str = "an MCAP file";

const MAT: &str = "read it in Python with `scipy.io.loadmat` and `joulebus.read_table`, or save it \
    in MATLAB with `writetable(T, 'log.csv')`";
const MAT_73: &str = "read it in Python with `h5py` or `mat73.loadmat`, and `joulebus.read_table`, \
    or save it in MATLAB with `writetable(T, 'log.csv')`";
const FEATHER: &str = "read it in Python with `pandas.read_feather` and `joulebus.read_table`";
const PICKLE: &str = "reading it runs its code. Only if you trust it, in Python \
    `pandas.read_pickle('FILE').to_csv('log.csv')`, \
                      or `torch.load` and `safetensors.torch.save_file`";
const UTF8: &str = "save it as UTF-8: `iconv -f UTF-16 -t UTF-8 FILE > log.csv`";
const UTF8_OF_16LE: &str = "save it as UTF-8: `iconv -f UTF-16LE -t UTF-8 FILE > log.csv`";
const UTF8_OF_16BE: &str = "save it as UTF-8: `iconv -f UTF-16BE -t UTF-8 FILE > log.csv`";
const UTF8_OF_32: &str = "save it as UTF-8: `iconv -f UTF-32 -t UTF-8 FILE > log.csv`";
const LFS: &str = "the file itself was not downloaded: `git lfs pull`";
const WEB: &str = "a page was downloaded instead of the file: use its raw or download link";
const UNPACK: &str = "unpack it first";
const TABLE: &str =
    "read it in Python with `pandas.read_excel` and `joulebus.read_table`, or save it as CSV";

const KINDS: [Kind; 50] = [
    (0, b"MATLAB 7.3 MAT-file", "a MATLAB file (v7.3, HDF5)", MAT_73),
    (0, b"MATLAB 5.0 MAT-file", "a MATLAB file (v5 to v7)", MAT),
    (
        0,
        b"\x89HDF\r\n\x1a\n",
        "an HDF5 file",
        "read it in Python with `pandas.read_hdf` or `h5py`, and `joulebus.read_table`",
    ),
    (
        0,
        b"#ROSBAG V",
        "a bag of ROS 1",
        "read it in Python with `joulebus.read_bag`, or convert it with `rosbags-convert --src FILE --dst bag \
         --dst-storage mcap`, then `joulebus import`",
    ),
    (
        0,
        b"SQLite format 3\0",
        "an SQLite file",
        "a bag (.db3) is read in Python by `joulebus.read_bag`, or converted with `ros2 bag convert` or \
         `rosbags-convert`. Another table: `pandas.read_sql` and `joulebus.read_table`",
    ),
    (
        0,
        b"ULog\x01\x12\x35",
        "a ULog of PX4",
        "`ulog2csv FILE` of the package pyulog, then --map time_us=timestamp with its battery_status",
    ),
    (
        0,
        b"\xa3\x95\x80\x80",
        "a DataFlash log of ArduPilot",
        "`mavlogdump.py --format csv --types BAT FILE` of the package pymavlink, then \
         --map time=timestamp,voltage_V=Volt,current_A=Curr",
    ),
    (0, b"WPILOG", "a log of WPILib", "export it as CSV with WPILib's DataLogTool, then --map"),
    (0, b"ARROW1\0\0", "an Arrow or Feather file", FEATHER),
    (
        0,
        b"\xff\xff\xff\xff",
        "an Arrow stream",
        "read it in Python with `polars.read_ipc_stream` and `joulebus.read_table`",
    ),
    (0, b"FEA1\0", "a Feather file", FEATHER),
    (
        0,
        b"PAR1\x15",
        "a Parquet file",
        "read it in Python with `pandas.read_parquet` and `joulebus.read_table`",
    ),
    (
        0,
        b"CDF\x01",
        "a NetCDF file",
        "read it in Python with `xarray.open_dataset(…).to_dataframe()` and `joulebus.read_table`",
    ),
    (
        0,
        b"CDF\x02",
        "a NetCDF file",
        "read it in Python with `xarray.open_dataset(…).to_dataframe()` and `joulebus.read_table`",
    ),
    (0, b"\x89MCAP0\r\n", MCAP, "`joulebus import` reads recordings of other programs"),
    (0, b"\x93NUMPY", "a NumPy array", UNPACK),
    (0, b"\x28\xb5\x2f\xfd", "a file compressed by zstd", "`zstd -d FILE`"),
    (0, b"\x1f\x8b", "a file compressed by gzip", "`gzip -d FILE`"),
    (4, b"1AY&SY", "a file compressed by bzip2", "`bzip2 -d FILE`"),
    (0, b"\xfd7zXZ\0", "a file compressed by xz", "`xz -d FILE`"),
    (0, b"\x04\x22\x4d\x18", "a file compressed by LZ4", "`lz4 -d FILE`"),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive", UNPACK),
    (0, b"Rar!\x1a\x07", "a RAR archive", UNPACK),
    (257, b"ustar", "a tar archive", UNPACK),
    (30, b"[Content_Types].xml", "an Excel file", TABLE),
    (0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an Excel file", TABLE),
    (0, b"PK\x03\x04", "a zip archive (.npz, .xlsx, …)", UNPACK),
    (0, b"PK\x05\x06", "an empty zip archive", UNPACK),
    (0, b"\x80\x02", "a pickle of Python", PICKLE),
    (0, b"\x80\x03", "a pickle of Python", PICKLE),
    (0, b"\x80\x04", "a pickle of Python", PICKLE),
    (0, b"\x80\x05", "a pickle of Python", PICKLE),
    (0, b"version https://git-lfs", "a pointer of Git LFS", LFS),
    (0, b"\xff\xfe\0\0", "text in UTF-32", UTF8_OF_32),
    (0, b"\0\0\xfe\xff", "text in UTF-32", UTF8_OF_32),
    (0, b"\xff\xfe", "text in UTF-16", UTF8),
    // Without a mark in front, the first letters of a column for the time.
    (0, b"t\0i\0m\0", "text in UTF-16", UTF8_OF_16LE),
    (0, b"\0t\0i\0m", "text in UTF-16", UTF8_OF_16BE),
    (0, b"\xfe\xff", "text in UTF-16", UTF8),
    (0, b"%PDF-", "a PDF file", "save the table itself as CSV"),
    (0, b"\x7fELF", "a program", "name the recording instead"),
    (0, b"<!", "a web page", WEB),
    (0, b"<html", "a web page", WEB),
    (0, b"<?xml", "an XML file", "save the table itself as CSV"),
    (0, b"{\"", "JSON", JSON),
    (0, b"{\n", "JSON", JSON),
    (0, b"{\r\n", "JSON", JSON),
    (0, b"[{", "JSON", JSON),
    (0, b"[[", "JSON", JSON),
    (0, b"[\n", "JSON", JSON),
];

/// Endings of names of such files, with the kind.
const ENDINGS: [(&str, &str); 30] = [
    ("mat", "a MATLAB file (v5 to v7)"),
    ("h5", "an HDF5 file"),
    ("hdf5", "an HDF5 file"),
    ("hdf", "an HDF5 file"),
    ("bag", "a bag of ROS 1"),
    ("db3", "an SQLite file"),
    ("sqlite", "an SQLite file"),
    ("db", "an SQLite file"),
    ("ulg", "a ULog of PX4"),
    ("bin", "a DataFlash log of ArduPilot"),
    ("wpilog", "a log of WPILib"),
    ("arrow", "an Arrow or Feather file"),
    ("feather", "an Arrow or Feather file"),
    ("parquet", "a Parquet file"),
    ("nc", "a NetCDF file"),
    ("zst", "a file compressed by zstd"),
    ("bz2", "a file compressed by bzip2"),
    ("xz", "a file compressed by xz"),
    ("lz4", "a file compressed by LZ4"),
    ("7z", "a 7z archive"),
    ("rar", "a RAR archive"),
    ("tar", "a tar archive"),
    ("xlsx", "an Excel file"),
    ("xls", "an Excel file"),
    ("zip", "a zip archive (.npz, .xlsx, …)"),
    ("npz", "a zip archive (.npz, .xlsx, …)"),
    ("pkl", "a pickle of Python"),
    ("pickle", "a pickle of Python"),
    ("json", "JSON"),
    ("jsonl", "JSON"),
];

const JSON: &str = "read it in Python with `pandas.read_json` (lines=True, if each line is an \
    object) and `joulebus.read_table`";

/// Recognises a file by its beginning `head`, unless it is text or of an unknown kind. At least
/// [`HEAD_BYTES`] are looked at, if the file has them. Whoever reads one of these kinds looks for
/// it before.
pub fn recognise(head: &[u8]) -> Option<Foreign> {
    // The length of a safetensors header may have the bytes of a short one.
    let is_model = head.get(8..).is_some_and(|rest| rest.starts_with(b"{\""));
    let found = KINDS.iter().find(|(at, magic, ..)| {
        let is_length = is_model && magic.len() == 2 && !magic.is_ascii();
        !is_length && head.get(*at..).is_some_and(|rest| rest.starts_with(magic))
    });
    let found = found.map(|(_, _, what, remedy)| Foreign { what, remedy });
    let mat_4 = || is_mat_4(head).then_some(Foreign { what: "a MATLAB file (v4)", remedy: MAT });
    found.or_else(mat_4)
}

/// True if a file begins with a variable of MATLAB 4, which has no magic bytes. It has type, rows,
/// columns, a flag for complex numbers, and the length of a name that ends with NUL.
fn is_mat_4(head: &[u8]) -> bool {
    let number = |at: usize, big: bool| -> Option<u32> {
        let bytes: [u8; 4] = head.get(4 * at..4 * at + 4)?.try_into().ok()?;
        Some(if big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    };
    let is_of = |big: bool| {
        let [kind, rows, columns, complex, length] = [0, 1, 2, 3, 4].map(|at| number(at, big));
        let kind_is = |kind: u32| {
            let digits = [kind / 1000, kind / 100 % 10, kind / 10 % 10, kind % 10];
            kind < 5_000
                && digits[0] == u32::from(big)
                && digits[1] == 0
                && digits[2] <= 5
                && digits[3] <= 2
        };
        let name = length.and_then(|length| head.get(20..20_usize.checked_add(length as usize)?));
        let is_name = name.and_then(<[u8]>::split_last).is_some_and(|(end, name)| {
            let is_letter = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
            *end == 0
                && name.first().is_some_and(u8::is_ascii_alphabetic)
                && name.iter().all(is_letter)
        });
        let is_size = |count: Option<u32>| count.is_some_and(|count| count < 1 << 28);
        kind.is_some_and(kind_is)
            && is_size(rows)
            && is_size(columns)
            && complex.is_some_and(|complex| complex <= 1)
            && is_name
    };
    is_of(false) || is_of(true)
}

/// Recognises a file of `contents` that was named as a model and is none of joulebus, with its
/// conversion. `None` for a damaged model, and for contents of no known kind. `path` is that of the
/// file.
pub fn of_model(path: &Path, contents: &[u8]) -> Option<String> {
    let shown = path.display();
    let stem = path.file_stem().map_or("model".into(), |stem| stem.to_string_lossy());
    let import = |file: &str| {
        // Not the file that is read.
        let made =
            stem.strip_suffix(".plain").map_or_else(|| format!("{stem}-scored"), str::to_owned);
        format!("`joulebus model import {file} --data RECORDINGS --out {made}.safetensors`")
    };
    let convert = |what: &str, source: &str, before: &str| {
        let plain = format!("{stem}.plain.safetensors");
        format!(
            "{what}. {before}State in Python how its author computed the features, such as \
             `joulebus.models.convert({source}, {plain:?}, unit=\"mW\", \
             lag_order=\"newest-first\", activation=\"gelu_erf\", \
             derivative=\"normalised-per-second\", magnitude=\"as-velocity\")`, then {}",
            import(&plain)
        )
    };
    let file = format!("{:?}", shown.to_string());
    if contents.get(8) == Some(&b'{') {
        // The header is looked at as text: a damaged one is one of joulebus if it says so.
        let length = contents.first_chunk().map_or(0, |length| u64::from_le_bytes(*length));
        let end = usize::try_from(length).unwrap_or(usize::MAX).saturating_add(8);
        // One that is cut says too little.
        let header = contents.get(8..end)?;
        let has = |word: &str| header.windows(word.len()).any(|found| found == word.as_bytes());
        if OWN.iter().any(|word| has(word)) {
            return None;
        }
        return Some(match has("\"lag_order\"") && has("\"layers.0.weight\"") {
            true => format!("a converted network. Import it: {}", import(&shown.to_string())),
            false => convert("safetensors of another program", &file, ""),
        });
    }
    let is_onnx = matches!(contents, [0x08, 1..=32, 0x12 | 0x1a | 0x22 | 0x2a | 0x3a | 0x42, ..]);
    if is_onnx {
        return Some(convert("a network of ONNX", &file, ""));
    }
    let kind = recognise(contents)?;
    let starts = |magic: &[u8]| contents.starts_with(magic);
    Some(if kind.remedy == PICKLE || starts(b"\x93NUMPY") || starts(b"PK\x03\x04") {
        let what = match kind.what.starts_with("a zip") {
            true => "a file of PyTorch or NumPy (a zip archive)",
            false => kind.what,
        };
        convert(what, &file, "")
    } else if starts(b"\x89HDF") {
        convert(kind.what, "arrays", "Read it with h5py or Keras into a dict of arrays. ")
    } else {
        kind.of_any_contents()
    })
}

/// Words of the header of every model of joulebus: one that is damaged still has some.
const OWN: [&str; 3] = ["joulebus-model", "\"training_data_sha256\"", "\"format_version\""];

/// Recognises a file by the ending of its name, which need not exist.
pub fn of_name(path: &Path) -> Option<Foreign> {
    let (_, named) = ENDINGS.iter().find(|(ending, _)| crate::ends_in(path, ending))?;
    let kind = KINDS.iter().find(|(_, _, what, _)| what == named);
    kind.map(|(_, _, what, remedy)| Foreign { what, remedy })
}

/// Recognises a file, if it is of one of the kinds and can be read.
pub fn of_file(path: &Path) -> Option<Foreign> {
    let mut head = Vec::new();
    let file = crate::open(path).ok()?;
    file.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
    recognise(&head)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{ENDINGS, KINDS, of_model, of_name, recognise};

    #[test]
    fn a_model_of_another_program_is_named_with_the_call_that_converts_it() {
        let file = |header: &str| {
            [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &[0; 8]].concat()
        };
        let of = |name: &str, contents: &[u8]| of_model(Path::new(name), contents);
        for (name, contents, what) in [
            ("a/x.pt", b"PK\x03\x04\0\0".to_vec(), "PyTorch or NumPy"),
            ("x.pt", b"\x80\x02\x8a\x0al\xfc\x9c".to_vec(), "a pickle"),
            ("x.npy", b"\x93NUMPY\x01\0v\0{'descr': '|O'".to_vec(), "a NumPy array"),
            ("x.onnx", b"\x08\x08\x12\x07pytorch".to_vec(), "a network of ONNX"),
            ("x.onnx", b"\x08\x0a:\x07pytorch".to_vec(), "a network of ONNX"),
            ("x.h5", b"\x89HDF\r\n\x1a\n".to_vec(), "an HDF5 file"),
            ("x.safetensors", file("{\"net.0.weight\":{}}"), "safetensors of another program"),
        ] {
            let said = of(name, &contents).expect(what);
            assert!(said.contains(what), "{said}");
            let source =
                if what.contains("HDF5") { "arrays".to_owned() } else { format!("{name:?}") };
            let call = format!("joulebus.models.convert({source}, \"x.plain.safetensors\", unit=");
            assert!(said.contains(&call), "{said}");
            let import = "`joulebus model import x.plain.safetensors --data RECORDINGS --out";
            assert!(said.contains(import), "{said}");
        }
        let plain = file("{\"__metadata__\":{\"lag_order\":\"a\"},\"layers.0.weight\":{}}");
        let said = of("p.safetensors", &plain).expect("it is known");
        let import = "a converted network. Import it: `joulebus model import p.safetensors --data \
                      RECORDINGS --out p-scored.safetensors`";
        assert_eq!(said, import);
        let own = file("{\"__metadata__\":{\"format\":\"joulebus-model\"");
        for none in [&own[..], &own[..30], b"", b"hello", b"robot,power\n1,2\n"] {
            assert_eq!(of("x", none), None, "{none:x?}");
        }
    }

    #[test]
    fn every_kind_is_known_by_its_first_bytes_and_no_table_of_text_is_one() {
        for (at, magic, what, remedy) in KINDS {
            // A kind further down may share the beginning of one above, never the other way.
            let head = [vec![b' '; at], magic.to_vec(), vec![1; 8]].concat();
            let found = recognise(&head).expect(what);
            assert_eq!((found.what, found.remedy), (what, remedy));
        }
        for (ending, named) in ENDINGS {
            let path = format!("a.{}", ending.to_uppercase());
            let found = of_name(Path::new(&path)).expect(ending);
            assert_eq!(found.what, named);
        }
        assert_eq!(of_name(Path::new("a.csv")), None);
        for length in [b"\x80\x02", b"\x80\x05", b"\x1f\x8b"] {
            let model = [&length[..], &[0; 6], b"{\"__metadata__\":"].concat();
            assert_eq!(recognise(&model), None, "{length:x?}");
        }
        for (kind, big) in [(0_u32, false), (1000, true), (50, false)] {
            let bytes = |number: u32| if big { number.to_be_bytes() } else { number.to_le_bytes() };
            let numbers = [kind, 300, 1, 0, 6].map(bytes);
            let head = [numbers.as_flattened(), b"power\0", &[0; 8]].concat();
            assert!(recognise(&head).is_some_and(|found| found.what.contains("v4")), "{kind}");
        }
        for text in [
            "",
            "time,power_W\n0,1\n",
            "# log\ntime,power_W\n",
            "\u{feff}t;P_W\n",
            "7,8",
            "BZh",
            "PAR1,1",
            "[s],[W]",
        ] {
            assert_eq!(recognise(text.as_bytes()), None, "{text:?}");
        }
    }
}
