//! The judgement of whole recordings: none of the real ones is implausible.

use joulebus_dataset::inspect::{Limits, judge};
use joulebus_dataset::trial::Trial;
use joulebus_testkit::recordings::trials;

#[test]
fn no_real_recording_is_implausible() {
    for platform in ["robotino", "borealtc_husky", "ase_rover"] {
        let Some(paths) = trials(platform) else {
            return;
        };
        for path in paths {
            let trial = Trial::read(&path).unwrap();
            let found = judge(&trial, &Limits::default());
            assert!(found.is_empty(), "{}: {found:#?}", path.display());
        }
    }
}
