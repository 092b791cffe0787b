//! The alert rules for Prometheus say of each alarm what its card says.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use joulebus_wire::AlarmCard;

/// `JOULEBUS_WRITE=1 cargo test -p joulebus-tests --test repository alert_rules` writes the rules.
#[test]
fn the_alert_rules_have_the_text_of_each_card() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/prometheus/joulebus.rules.yml");
    let old = fs::read_to_string(&path).unwrap();
    let (before, rest) = old.split_once("            {{ if eq $labels.alarm").unwrap();
    let (_, after) = rest.split_once("            {{ end }}").unwrap();
    let mut new = before.to_owned();
    for (at, AlarmCard { name, meaning, check, .. }) in AlarmCard::all().enumerate() {
        let otherwise = if at == 0 { "" } else { "else " };
        let condition = format!("{{{{ {otherwise}if eq $labels.alarm \"{name}\" }}}}");
        writeln!(new, "            {condition}{meaning} {check}").unwrap();
    }
    new += &format!("            {{{{ end }}}}{after}");
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, new).unwrap();
    } else {
        assert!(old == new, "{}: run this test again with JOULEBUS_WRITE=1", path.display());
    }
}
