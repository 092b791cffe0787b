//! Files not created by joulebus are neither read, changed nor removed by any subcommand.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use joulebus_tests::{Arena, Child, Ended, PATIENCE, Setup, eventually, figure};

/// Everything below a directory: kind, mode, and content or target. Symbolic links are not
/// followed.
type Tree = BTreeMap<PathBuf, (u32, Vec<u8>)>;

fn tree(path: &Path) -> Tree {
    let mut found = Tree::new();
    let metadata = fs::symlink_metadata(path).unwrap();
    let kind = metadata.file_type();
    let content = if kind.is_file() {
        fs::read(path).unwrap()
    } else if kind.is_symlink() {
        let target: OsString = fs::read_link(path).unwrap().into();
        target.into_encoded_bytes()
    } else {
        Vec::new()
    };
    if kind.is_dir() {
        for entry in fs::read_dir(path).unwrap() {
            found.extend(tree(&entry.unwrap().path()));
        }
    }
    found.insert(path.to_owned(), (metadata.mode(), content));
    found
}

fn directory(path: &Path, mode: u32) {
    fs::DirBuilder::new().mode(0o700).create(path).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

/// A directory of the user: a file, directories with names that iceoryx2 uses, all older than the
/// limit for objects under construction.
fn fill(path: &Path) {
    fs::write(path.join("letter.txt"), "dear\n").unwrap();
    for inner in ["photos", "nodes", "services"] {
        directory(&path.join(inner), 0o755);
        fs::write(path.join(inner).join("sea.jpg"), [7; 3_000]).unwrap();
        directory(&path.join(inner).join("1234567890"), 0o700);
        fs::write(path.join(inner).join("1234567890/sand.jpg"), [8; 300]).unwrap();
    }
}

/// The processes of a fleet that access its directory, each stopped soon if it works.
fn everybody(arena: &Arena) -> Vec<(&'static str, Command)> {
    let capture = arena.files().join("run.mcap").display().to_string();
    let controller = arena.probe(&["controller", "fleet", "0", "2", "30"]);
    vec![
        ("run", arena.command(&["run"])),
        ("doctor", arena.command(&["doctor"])),
        ("doctor --fix", arena.command(&["doctor", "--fix"])),
        ("source", arena.probe(&["source", "fleet"])),
        ("controller", controller),
        ("planner", arena.probe(&["planner"])),
        ("consumer", arena.probe(&["consumer"])),
        ("recorder", arena.probe(&["recorder"])),
        ("publish", arena.command(&["publish", "sim", "--seed", "7", "--robots", "2"])),
        ("watch", arena.command(&["watch", "--once"])),
        ("record", arena.command(&["record", "-o", &capture])),
    ]
}

/// All must refuse the fleet's directory with a reason, and leave the root unchanged.
fn everybody_refuses(what: &str, arena: &Arena, shows: &str) {
    let before = tree(arena.domain().root());
    for (name, command) in everybody(arena) {
        let ended: Ended = Child::spawn(name, command).wait();
        assert_eq!(ended.code(), Some(1), "{what}: {name}: {ended:?}");
        // The recorder may have created its file.
        let _ = fs::remove_file(arena.files().join("run.mcap"));
        let printed = format!("{}{}", ended.errors(), ended.text());
        let path = arena.domain().directory().display().to_string();
        assert!(printed.contains(&path), "{what}: {name}: {printed}");
        assert!(printed.contains(shows), "{what}: {name}: {printed}");
        assert!(!printed.contains("rm -r"), "{what}: {name}: {printed}");
        assert_eq!(tree(arena.domain().root()), before, "{what}: {name}");
    }
}

const REFUSED: &str = "was not made by joulebus";

#[test]
fn a_directory_not_created_by_joulebus_is_refused_and_unchanged() {
    type Make = fn(&Arena, &Path);
    let kinds: [(&str, &str, Make); 9] = [
        ("somebody's folder", REFUSED, |_, path| {
            directory(path, 0o700);
            fill(path);
        }),
        ("somebody's folder, open to others", REFUSED, |_, path| {
            directory(path, 0o755);
            fill(path);
        }),
        ("an empty folder", REFUSED, |_, path| directory(path, 0o700)),
        ("the folder of an older release", REFUSED, |_, path| {
            directory(path, 0o700);
            fill(path);
            fs::write(path.join("members.lock"), "").unwrap();
        }),
        ("a marker that is somebody's text", REFUSED, |_, path| {
            directory(path, 0o700);
            fs::write(path.join("members.lock"), "joulebus directory\n").unwrap();
        }),
        ("a marker that is a pipe", REFUSED, |_, path| {
            directory(path, 0o700);
            let fifo = path.join("members.lock");
            let made = Command::new("mkfifo").arg(fifo).status().unwrap();
            assert!(made.success());
        }),
        ("a marker that is a link", REFUSED, |arena, path| {
            let text = format!(
                "joulebus directory 1\nfleet {}\nprefix {}\nboot x\n",
                arena.domain().fleet(),
                arena.domain().shm_prefix()
            );
            fs::write(arena.files().join("marker"), text).unwrap();
            directory(path, 0o700);
            symlink(arena.files().join("marker"), path.join("members.lock")).unwrap();
        }),
        ("the folder of another fleet", "is in use for", |_, path| {
            directory(path, 0o700);
            let text = "joulebus directory 1\nfleet other\nprefix jbt_00000000_\nboot x\n";
            fs::write(path.join("members.lock"), text).unwrap();
        }),
        ("a link to somebody's folder", "symbolic link", |arena, path| {
            let elsewhere = arena.files().join("elsewhere");
            directory(&elsewhere, 0o700);
            fill(&elsewhere);
            symlink(elsewhere, path).unwrap();
        }),
    ];
    let count = kinds.len();
    for (what, shows, make) in kinds {
        let arena = Arena::new(&Setup::default());
        let root = arena.domain().root().to_owned();
        directory(&root, 0o700);
        make(&arena, &arena.domain().directory());
        let files = tree(arena.files());
        everybody_refuses(what, &arena, shows);
        assert_eq!(tree(arena.files()), files, "{what}");
        fs::remove_dir_all(&root).unwrap();
    }
    figure(
        "somebody's folder where the fleet's belongs",
        format_args!("{count} kinds, 11 processes each: 0 files changed"),
    );
}

#[test]
fn a_root_not_created_by_joulebus_is_neither_changed_nor_removed() {
    let arena = Arena::new(&Setup::default());
    let root = arena.domain().root().to_owned();
    directory(&root, 0o755);
    for arguments in [&["run"][..], &["doctor"], &["doctor", "--fix"]] {
        let ended = arena.run(arguments);
        assert_eq!(ended.code(), Some(1), "{arguments:?}: {ended:?}");
        let printed = format!("{}{}", ended.errors(), ended.text());
        assert!(printed.contains("has mode 0755"), "{arguments:?}: {printed}");
    }
    fs::set_permissions(&root, fs::Permissions::from_mode(0o700)).unwrap();
    fs::write(root.join("letter.txt"), "dear\n").unwrap();
    fs::write(root.join("worker-home.lock"), "keep out\n").unwrap();
    let before = tree(&root);
    arena.worker().stop();
    assert_eq!(tree(&root), before);
    assert_eq!(arena.run(&["doctor", "--fix"]).code(), Some(0));
    assert_eq!(tree(&root), before);
    fs::remove_file(root.join("letter.txt")).unwrap();
    fs::remove_file(root.join("worker-home.lock")).unwrap();
    arena.worker().stop();
    assert!(root.exists(), "an empty root is somebody's as well");
    fs::remove_dir(&root).unwrap();
    arena.worker().stop();
}

#[test]
fn foreign_files_in_a_fleets_directory_are_kept() {
    let arena = Arena::new(&Setup::default());
    let elsewhere = arena.files().join("elsewhere");
    directory(&elsewhere, 0o700);
    fill(&elsewhere);
    let outside = tree(&elsewhere);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut controller = arena.controller("controller", 0, 2, 60.0);
    planner.forecast("it works", |frame| frame.robot(1).map(|_| ()));

    let folder = arena.domain().directory();
    let prefix = arena.domain().shm_prefix().to_owned();
    directory(&folder.join("photos"), 0o700);
    fill(&folder.join("photos"));
    let mut puts: Vec<PathBuf> = vec![folder.join("photos")];
    for inner in ["", "nodes", "services"] {
        let inner = folder.join(inner);
        let file = inner.join("letter.txt");
        fs::write(&file, "dear\n").unwrap();
        let empty = inner.join("empty");
        fs::write(&empty, "").unwrap();
        // With names that iceoryx2 uses, and leading elsewhere.
        let link = inner.join("170141183460469231731687303715884105727");
        symlink(&elsewhere, &link).unwrap();
        let named = inner.join(format!("{prefix}letter"));
        symlink(elsewhere.join("letter.txt"), &named).unwrap();
        puts.extend([file, empty, link, named]);
    }
    let node = folder.join("nodes/170141183460469231731687303715884105726");
    directory(&node, 0o700);
    fs::write(node.join("sea.jpg"), [7; 300]).unwrap();
    puts.push(node.join("sea.jpg"));
    let shm_link = PathBuf::from(format!("/dev/shm/{prefix}letter.data"));
    symlink(elsewhere.join("letter.txt"), &shm_link).unwrap();
    puts.push(shm_link.clone());
    let trees = || -> Vec<Tree> { puts.iter().map(|path| tree(path)).collect() };
    let before = trees();

    // Live members clean up after a killed one.
    let living = arena.stale_files();
    let is_gone = |path: &PathBuf| fs::symlink_metadata(path).is_err();
    controller.kill();
    // Not their number: the thread that answers questions may open its ports in between.
    eventually("what it left is removed", || living.iter().any(is_gone));
    assert_eq!(trees(), before, "beside living processes");
    assert_eq!(arena.run(&["doctor", "--fix"]).code(), Some(0));
    assert_eq!(trees(), before, "doctor --fix beside living processes");
    // The next start finds all of it, with no member alive.
    worker.kill();
    planner.child.kill();
    arena.worker().stop();
    assert_eq!(trees(), before, "a cold start, and the last to leave");
    arena.worker().kill();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(arena.run(&["doctor", "--fix"]).code(), Some(0));
    assert_eq!(trees(), before, "doctor --fix after a kill");
    assert_eq!(tree(&elsewhere), outside);

    for path in puts.iter().rev() {
        let _ = fs::remove_file(path).or_else(|_| fs::remove_dir_all(path));
    }
    fs::remove_dir(&node).unwrap();
    arena.worker().stop();
}

#[test]
fn a_directory_of_an_earlier_boot_with_our_marker_is_cleaned_and_reused() {
    let arena = Arena::new(&Setup::default());
    arena.worker().kill();
    let marker = arena.domain().directory().join("members.lock");
    let text = fs::read_to_string(&marker).unwrap();
    let (head, _) = text.split_once("boot ").expect("the marker names the boot");
    fs::write(&marker, format!("{head}boot of-last-week\n")).unwrap();
    let _worker = arena.worker();
    let text = fs::read_to_string(&marker).unwrap();
    assert!(!text.contains("of-last-week"), "{text}");
}

#[test]
fn concurrent_starts_create_one_directory_and_none_is_refused() {
    let arena = Arena::new(&Setup { max_planners: 16, ..Setup::default() });
    for round in 0..8 {
        let mut planners: Vec<Child> =
            (0..8).map(|_| Child::spawn("planner", arena.probe(&["planner"]))).collect();
        for planner in &planners {
            assert!(!planner.lines(0, PATIENCE).is_empty(), "round {round}: {}", planner.tail());
        }
        for planner in &mut planners {
            if round % 2 == 0 {
                planner.kill();
            } else {
                planner.finish();
            }
        }
    }
    arena.worker().stop();
}

/// Other files at the path of the worker's lock.
#[test]
fn an_invalid_lock_file_is_refused_and_unchanged() {
    let arena = Arena::new(&Setup::default());
    let root = arena.domain().root().to_owned();
    directory(&root, 0o700);
    let lock = root.join(format!("worker-{}.lock", arena.domain().fleet()));
    let letter = arena.files().join("letter.txt");
    fs::write(&letter, "dear\n").unwrap();
    let numbers = arena.files().join("numbers.txt");
    fs::write(&numbers, "12 34\n").unwrap();
    let what: [(&str, &dyn Fn()); 6] = [
        ("text", &|| fs::write(&lock, "dear\n").unwrap()),
        ("a long file", &|| {
            fs::write(&lock, "1 ".repeat(200)).unwrap();
        }),
        ("a link", &|| symlink(&letter, &lock).unwrap()),
        ("a link to numbers", &|| symlink(&numbers, &lock).unwrap()),
        ("a second name", &|| fs::hard_link(&numbers, &lock).unwrap()),
        ("a pipe", &|| {
            assert!(Command::new("mkfifo").arg(&lock).status().unwrap().success());
        }),
    ];
    for (what, make) in what {
        make();
        let before = (tree(&root), tree(arena.files()));
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        assert!(ended.errors().contains("not a lock file"), "{what}: {ended:?}");
        for arguments in [&["doctor"][..], &["doctor", "--fix"]] {
            assert!(arena.run(arguments).code().is_some(), "{what}");
        }
        assert_eq!((tree(&root), tree(arena.files())), before, "{what}");
        fs::remove_file(&lock).unwrap();
    }
    // Contents that a power failure may leave are accepted.
    for what in [&b""[..], b"12", b"4711 1700000000000000000\n", &[0; 40]] {
        fs::write(&lock, what).unwrap();
        arena.worker().stop();
    }
    fs::remove_dir(&root).unwrap();
}
