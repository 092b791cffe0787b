//! Checks the file of shards: which links' workers may lead which robots.

use joulebus_config::Config;

use crate::config::MAX_BYTES;
use crate::config::check::Check;
use crate::config::file::{ShardSection, ShardsFile, Text};
use crate::protocol::shards::{MAX_CANDIDATES, MAX_SHARDS, Shard, Shards};

impl Check<'_> {
    /// Reads the file of shards. Its problems are reported with its own lines.
    pub(super) fn shards(&mut self, name: &Text, config: &Config) -> Option<Shards> {
        let path = self.folder.join(name.get_ref());
        let text = match joulebus_files::read_to_string(&path, MAX_BYTES) {
            Ok(text) => text,
            Err(error) => {
                let what = format!("= {:?} cannot be read: {error}", name.get_ref());
                let remedy = "Copy the fleet's file of shards beside this one";
                self.problem(Some(name.span().start), "shards", what, remedy);
                return None;
            }
        };
        let mut check = Check {
            file: path.display().to_string(),
            folder: self.folder.clone(),
            text: &text,
            problems: Vec::new(),
        };
        let shards = check.shards_of(config);
        self.problems.append(&mut check.problems);
        shards
    }

    fn shards_of(&mut self, config: &Config) -> Option<Shards> {
        let file: ShardsFile = match toml::from_str(self.text) {
            Ok(file) => file,
            Err(error) => {
                let at = error.span().map(|span| span.start);
                let what = format!("cannot be read: {}", error.message().replace('\n', "; "));
                self.problem(at, "", what, "docs/how-to/shards.md has all keys");
                return None;
            }
        };
        let found = file.shard.len();
        if !(1..=MAX_SHARDS).contains(&found) {
            let what = format!("are {found}");
            let remedy = format!("Allowed: 1 to {MAX_SHARDS}");
            self.problem(None, "shard", what, &remedy);
        }
        let all: Vec<Shard> = file.shard.iter().map(|it| self.shard(it, config)).collect();
        self.distinct(&file, |shard| std::slice::from_ref(&shard.name), "shard.name");
        self.distinct(&file, |shard| &shard.workers, "shard.workers");
        let listed = file.shard.iter().filter(|it| it.robots.is_some()).count();
        if listed != 0 && listed != found {
            let what = format!("stands in {listed} of {found} shards");
            let remedy =
                "List the robots of every shard, or of none: then they are shared out by hashing";
            self.problem(None, "shard.robots", what, remedy);
            return None;
        }
        let shards = Shards::new(all);
        if listed > 0 {
            self.covers(&shards, config);
        }
        Some(shards)
    }

    fn shard(&mut self, section: &ShardSection, config: &Config) -> Shard {
        let found = section.workers.len();
        if !(1..=MAX_CANDIDATES).contains(&found) {
            let what = format!("names {found} links");
            let remedy = format!("Allowed: 1 to {MAX_CANDIDATES}, the preferred leader first");
            let at = Some(section.name.span().start);
            self.problem(at, "shard.workers", what, &remedy);
        }
        let mut workers = Vec::new();
        for worker in &section.workers {
            workers.push(self.name(worker, "shard.workers"));
        }
        let robots = self.robots(section.robots.as_deref(), "shard.robots", config);
        Shard {
            name: self.name(&section.name, "shard.name"),
            workers,
            robots: robots.ranges().to_vec(),
        }
    }

    /// Checks that no name occurs twice.
    fn distinct<'f>(
        &mut self,
        file: &'f ShardsFile,
        names: impl Fn(&'f ShardSection) -> &'f [Text],
        key: &str,
    ) {
        let mut seen: Vec<&str> = Vec::new();
        for name in file.shard.iter().flat_map(names) {
            if seen.contains(&name.get_ref().as_str()) {
                let what = format!("= {:?} stands twice", name.get_ref());
                self.problem(Some(name.span().start), key, what, "Name each once");
            }
            seen.push(name.get_ref());
        }
    }

    /// Checks that every robot of the fleet is in a shard.
    fn covers(&mut self, shards: &Shards, config: &Config) {
        let mut ranges: Vec<(u32, u32)> = Vec::new();
        for shard in shards.all() {
            ranges.extend(&shard.robots);
        }
        ranges.sort_unstable();
        if let Some(pair) = ranges.windows(2).find(|pair| pair[1].0 <= pair[0].1) {
            let what = format!("has robot {} in two shards", pair[1].0);
            self.problem(None, "shard.robots", what, "List each robot once");
        }
        let platforms = &config.settings().platforms;
        let ids = platforms.iter().flat_map(|platform| &platform.robots);
        for ids in ids {
            if let Some(robot) = unlisted(&ranges, (*ids.start(), *ids.end())) {
                let what = format!("does not have robot {robot}");
                let remedy = "Every robot of `platform.robots` belongs into one shard";
                self.problem(None, "shard.robots", what, remedy);
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
