//! Inputs of an evaluation: recordings, their platforms, the evaluated rows, and options.

use std::path::PathBuf;

use joulebus_config::Config;
use joulebus_dataset::trial::ColumnMap;
use joulebus_eval::score::{Design, Options, Recording, Subject};
use joulebus_predictor::Model;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::UsageError;
use joulebus_settings::{FleetSettings, Platform};
use joulebus_statistics::bootstrap::Bootstrap;

use crate::design::DesignArguments;
use crate::judgement::{AcceptArguments, Judged};
use crate::recordings::{find_recordings, open, open_with_ids};
use crate::trials::TrialFiles;

/// Recordings, and options of their evaluation.
#[derive(Debug, clap::Args)]
pub(crate) struct Selection {
    #[command(flatten)]
    trials: TrialFiles,
    #[command(flatten)]
    accept: AcceptArguments,
    #[command(flatten)]
    config: ConfigFile,
    #[command(flatten)]
    held_out: DesignArguments,
    /// Seed of the split and of the bootstrap
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Draws for confidence intervals, at most 1,000,000 (0 disables them)
    #[arg(long, value_name = "N", default_value_t = Bootstrap::default().resamples)]
    resamples: u32,
}

/// The recordings of one platform.
pub(crate) struct Section {
    /// The config's platform. `None` takes each recording as it is.
    platform: Option<Platform>,
    /// Its index in the config, which is also its model's.
    pub(crate) place: usize,
    settings: FleetSettings,
    recordings: Vec<Recording>,
    /// Rules for reading further recordings of it.
    map: ColumnMap,
    accept: AcceptArguments,
}

impl Section {
    pub(crate) fn subject<'a>(&'a self, models: &'a [Model], design: &'a Design) -> Subject<'a> {
        Subject {
            settings: &self.settings,
            platform: self.platform.as_ref(),
            models,
            recordings: &self.recordings,
            design,
        }
    }

    pub(crate) fn recordings(&self) -> &[Recording] {
        &self.recordings
    }

    pub(crate) fn name(&self) -> &str {
        let platform = self.platform.as_ref();
        platform.map_or("recorded", |platform| &platform.name)
    }
}

impl Selection {
    pub(crate) fn config(&self) -> anyhow::Result<Config> {
        self.config.load()
    }

    pub(crate) fn options(&self) -> Options {
        let (resamples, seed) = (self.resamples, self.seed);
        let bootstrap = Bootstrap { resamples, seed, ..Bootstrap::default() };
        Options { bootstrap, ..Options::default() }
    }

    /// Judges what is implausible in the recordings.
    ///
    /// # Errors
    /// A finding that makes results wrong and is not accepted.
    pub(crate) fn judge(&self, sections: &[Section]) -> anyhow::Result<Vec<Judged>> {
        let mut judged = Vec::new();
        for section in sections {
            judged.extend(section.accept.recordings(&section.recordings)?);
        }
        Ok(judged)
    }

    /// Reads the recordings, and sorts them by platform. If a model was given, but neither a config
    /// nor robot ids, they are taken as recorded.
    pub(crate) fn sections(
        &self,
        config: &Config,
        model_named: bool,
    ) -> anyhow::Result<Vec<Section>> {
        let settings = config.settings();
        let section = |platform, place, recordings, map, accept| Section {
            platform,
            place,
            settings: settings.clone(),
            recordings,
            map,
            accept,
        };
        if model_named && self.config.config.is_none() && !self.trials.names_robots() {
            let map = self.trials.map();
            let recordings = open(self.trials.files()?, &map)?;
            return Ok(vec![section(None, 0, recordings, map, self.accept.clone())]);
        }
        let mut sections = Vec::new();
        let mut files = self.trials.assigned(settings)?;
        for (place, platform) in settings.platforms.iter().enumerate() {
            let is_its =
                |(id, _): &mut (u32, PathBuf)| platform.robots.iter().any(|ids| ids.contains(id));
            let own: Vec<(u32, PathBuf)> = files.extract_if(.., is_its).collect();
            if !own.is_empty() {
                let map = self.trials.map_of(config, place)?;
                let accept = self.accept.or_configured(config, [place])?;
                let recordings = open_with_ids(&own, &map)?;
                sections.push(section(Some(platform.clone()), place, recordings, map, accept));
            }
        }
        match files.first() {
            None => Ok(sections),
            Some((id, file)) => {
                let (name, platforms) = (file.display(), settings.platforms.len());
                let what =
                    format!("{name}: robot {id} belongs to none of the {platforms} platforms");
                Err(UsageError(format!("{what}. Add its id to one of them")).into())
            }
        }
    }

    /// The evaluated rows. Those that a model was trained on are apart.
    pub(crate) fn design(&self, section: &Section, models: &[Model]) -> anyhow::Result<Design> {
        let design = self.held_out.design(&section.recordings, self.seed, |fit| {
            let others = open(find_recordings(fit)?, &section.map)?;
            section.accept.recordings(&others)?;
            Ok(others)
        })?;
        Ok(design.hold_apart(&section.recordings, models)?)
    }
}
