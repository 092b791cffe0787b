//! Lists of CPUs in the kernel's notation.

use std::ops::RangeInclusive;

/// Size of Linux's CPU mask.
const MAX_CPUS: usize = 1024;

/// The CPUs in the order of the list, each once: `"2-3,6"`. `None` if the text is not such a list.
pub(crate) fn parse(text: &str) -> Option<Vec<usize>> {
    if text.trim().is_empty() {
        return Some(Vec::new());
    }
    let mut cpus: Vec<usize> = Vec::new();
    for cpu in text.split(',').map(range).collect::<Option<Vec<_>>>()? {
        for cpu in cpu {
            if cpus.contains(&cpu) {
                return None;
            }
            cpus.push(cpu);
        }
    }
    Some(cpus)
}

fn range(text: &str) -> Option<RangeInclusive<usize>> {
    let cpu = |text: &str| text.trim().parse().ok().filter(|cpu| *cpu < MAX_CPUS);
    let (first, last) = match text.split_once('-') {
        Some((first, last)) => (cpu(first)?, cpu(last)?),
        None => (cpu(text)?, cpu(text)?),
    };
    (first <= last).then_some(first..=last)
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn lists_of_cpus_are_parsed_in_order_and_without_repetition() {
        for (text, expected) in [
            ("", Some(vec![])),
            (" ", Some(vec![])),
            ("1", Some(vec![1])),
            ("2-4, 0", Some(vec![2, 3, 4, 0])),
            ("1023", Some(vec![1023])),
            ("1024", None),
            ("1,1", None),
            ("0-2,2", None),
            ("3-2", None),
            ("-1", None),
            ("1,", None),
            ("all", None),
        ] {
            assert_eq!(parse(text), expected, "{text:?}");
        }
    }
}
