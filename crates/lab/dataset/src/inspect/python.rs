//! Messages for Python, where options are arguments.

/// A message with Python's arguments in place of the options of the program.
pub fn in_python(text: &str) -> String {
    const OPTIONS: [&str; 3] = ["--map ", "--current ", "--accept "];
    let mut told = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        told += &rest[..at];
        rest = &rest[at..];
        let Some(option) = OPTIONS.into_iter().find(|option| rest.starts_with(option)) else {
            told += "--";
            rest = &rest[2..];
            continue;
        };
        let after = &rest[option.len()..];
        // A value with spaces is in quotes.
        let (value, behind) = match after.strip_prefix('\'').and_then(|text| text.split_once('\''))
        {
            Some(quoted) => quoted,
            None => {
                let end = after.find(char::is_whitespace).unwrap_or(after.len());
                let end = after[..end].trim_end_matches(['.', ',', ';', ':', ')']).len();
                after.split_at(end)
            }
        };
        told += &match option {
            "--map " => {
                let pairs = value.split(',').map(|pair| match pair.rsplit_once('=') {
                    // := is a value for every row.
                    Some((quantity, column)) => format!("{quantity:?}: {column:?}"),
                    None => format!("{pair:?}: \"…\""),
                });
                format!("columns={{{}}}", pairs.collect::<Vec<_>>().join(", "))
            }
            "--current " => format!("current={value:?}"),
            _ => format!("accept=[{value:?}]"),
        };
        rest = behind;
    }
    told + rest
}

#[cfg(test)]
mod tests {
    use super::in_python;

    #[test]
    fn options_are_told_as_arguments() {
        for (text, expected) in [
            (
                "state it, --map power_mW=p or --map power_W=p, or",
                "state it, columns={\"power_mW\": \"p\"} or columns={\"power_W\": \"p\"}, or",
            ),
            (
                "Name them: --map 'time_s=t,power_W=Power TOT' (x)",
                "Name them: columns={\"time_s\": \"t\", \"power_W\": \"Power TOT\"} (x)",
            ),
            ("with --map missing:=-1. If", "with columns={\"missing:\": \"-1\"}. If"),
            (
                "turn it with --current discharge-negative. -- add --accept sign.",
                "turn it with current=\"discharge-negative\". -- add accept=[\"sign\"].",
            ),
        ] {
            assert_eq!(in_python(text), expected);
        }
    }
}
