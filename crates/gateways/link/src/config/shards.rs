//! Checks the file of shards: which links' workers may lead which robots.

use joulebus_config::{CheckedFile, Config, ConfigError, File, Section, Text};

use crate::config::check::Check;
use crate::protocol::shards::{Shard, Shards};

impl Check {
    /// Reads the file of shards. Its problems are reported with its own lines.
    pub(super) fn shards(&mut self, name: &Text, config: &Config) -> Option<Shards> {
        let file = match CheckedFile::load(&name.file(), File::Shards) {
            Ok(file) => file,
            Err(error) => {
                if let ConfigError::Read { source, .. } = &error {
                    let remedy = "Copy the fleet's file of shards beside this one";
                    self.add(name.problem(&format!("cannot be read: {source}"), remedy));
                }
                error.problems().iter().cloned().for_each(|problem| self.add(problem));
                return None;
            }
        };
        let is_sound = file.problems.is_empty();
        file.problems.iter().cloned().for_each(|problem| self.add(problem));
        let root = file.root();
        let list: Vec<Section<'_>> = root.list("shard").collect();
        if list.is_empty() && is_sound {
            let what = "is missing: there is no [[shard]]".to_owned();
            self.add(root.problem("shard", what, "Write [[shard]] with `name` and `workers`"));
        }
        let all: Vec<Shard> =
            list.iter().filter_map(|section| self.shard(section, config)).collect();
        self.distinct(list.iter().filter_map(|shard| shard.text("name")));
        self.distinct(list.iter().flat_map(|shard| shard.texts("workers")));
        let found = list.len();
        let listed = list.iter().filter(|shard| shard.has("robots")).count();
        if listed != 0 && listed != found {
            let what = format!("stands in {listed} of {found} shards");
            let remedy = "List the robots of every shard, or of none: then a hash of the id assigns each \
                    robot";
            let with = list.iter().find(|shard| shard.has("robots"))?;
            self.add(with.problem("robots", what, remedy));
            return None;
        }
        let shards = Shards::new(all);
        if listed > 0 {
            self.covers(&shards, &list, config);
        }
        Some(shards)
    }

    fn shard(&mut self, section: &Section<'_>, config: &Config) -> Option<Shard> {
        let workers = section.texts("workers");
        Some(Shard {
            name: section.text("name")?.to_string(),
            workers: workers.iter().map(|text| text.to_string()).collect(),
            robots: self.robots(section, config).ranges().to_vec(),
        })
    }

    /// Checks that no name occurs twice.
    fn distinct(&mut self, names: impl Iterator<Item = Text>) {
        let mut seen: Vec<Text> = Vec::new();
        for name in names {
            if seen.iter().any(|other| **other == *name) {
                self.add(name.problem("stands twice", "Name each once"));
            }
            seen.push(name);
        }
    }

    /// Checks that every robot of the fleet is in a shard.
    fn covers(&mut self, shards: &Shards, list: &[Section<'_>], config: &Config) {
        let [first, ..] = list else { return };
        let mut ranges: Vec<(u32, u32)> = Vec::new();
        for shard in shards.all() {
            ranges.extend(&shard.robots);
        }
        ranges.sort_unstable();
        if let Some(pair) = ranges.windows(2).find(|pair| pair[1].0 <= pair[0].1) {
            let what = format!("has robot {} in two shards", pair[1].0);
            self.add(first.problem("robots", what, "List each robot once"));
        }
        let platforms = &config.settings().platforms;
        let ids = platforms.iter().flat_map(|platform| &platform.robots);
        for ids in ids {
            if let Some(robot) = unlisted(&ranges, (*ids.start(), *ids.end())) {
                let what = format!("does not have robot {robot}");
                let remedy = "Every robot of `platform.robots` belongs into one shard";
                self.add(first.problem("robots", what, remedy));
                return;
            }
        }
    }
}

/// The first id of the range that no entry of the sorted `ranges` contains.
fn unlisted(ranges: &[(u32, u32)], (first, last): (u32, u32)) -> Option<u32> {
    let mut next = first;
    for (begin, end) in ranges {
        if *begin > next {
            break;
        }
        if *end >= last {
            return None;
        }
        next = next.max(end + 1);
    }
    (next <= last).then_some(next)
}
