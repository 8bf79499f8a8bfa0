//! Logs as the command line names them.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use hal_sim::log::{Format, Header, LogError, LogReader};
use hal_sim::unit::Unit;
use indicatif::{ProgressBar, ProgressBarIter};
use tempfile::NamedTempFile;

use super::args::LogArgs;
use super::output::{bar, cannot_write, words};

/// A log, and a bar that goes on as it is read.
pub(super) type OpenLog = LogReader<BufReader<ProgressBarIter<File>>>;

/// A log that is to be read, also more than once.
pub(super) struct Input {
    pub(super) path: PathBuf,
    pub(super) name: String,
    format: Format,
    /// Standard input as a file, which can be read more than once.
    kept: Option<NamedTempFile>,
}

impl Input {
    pub(super) fn new(args: &LogArgs) -> Result<Self, String> {
        let mut format = args
            .format
            .as_deref()
            .map_or(Ok(Format::default()), Format::find)
            .map_err(words)?;
        if let Some(mounting) = args.mounting {
            format = format.with_mounting(mounting);
        }
        if let Some(unit) = args.encoder_unit {
            format = format.with_encoder_unit(unit);
        }
        if let Some(rate_hz) = args.rate_hz {
            format = format.with_rate(rate_hz);
        }
        let mut input = Self {
            path: args.log.clone(),
            name: args.log.display().to_string(),
            format,
            kept: None,
        };
        if args.log == Path::new("-") {
            "standard input".clone_into(&mut input.name);
            let mut kept = NamedTempFile::new().map_err(|e| input.cannot_read(&e))?;
            io::copy(&mut io::stdin().lock(), &mut kept).map_err(|e| input.cannot_read(&e))?;
            input.kept = Some(kept);
        }
        Ok(input)
    }

    fn cannot_read(&self, error: &io::Error) -> String {
        LogError::cannot_read(&self.name, error).to_string()
    }

    fn file(&self) -> io::Result<(u64, File)> {
        let file = match &self.kept {
            Some(kept) => kept.reopen()?,
            None => File::open(&self.path)?,
        };
        Ok((file.metadata()?.len(), file))
    }

    pub(super) fn open(&self, quiet: bool) -> Result<(OpenLog, ProgressBar), String> {
        let (length, file) = self.file().map_err(|e| self.cannot_read(&e))?;
        let bar = bar(length, "bytes", quiet);
        let input = BufReader::with_capacity(1 << 16, bar.wrap_read(file));
        let log = LogReader::with_format(input, &self.name, &self.format).map_err(words)?;
        Ok((log, bar))
    }

    /// The file with the figures of the IMU that is beside the log, where there is one.
    pub(super) fn figures(&self) -> Option<PathBuf> {
        let beside = self.kept.is_none().then(|| Unit::beside(&self.path));
        beside.filter(|beside| beside.exists())
    }

    /// Writes the figures of the log's IMU beside the log that was made of it, so that `replay` finds them there.
    pub(super) fn pass_figures_on(&self, header: Option<&Header>, to: &Path, quiet: bool) -> Result<(), String> {
        let unit = match (header, self.figures()) {
            (Some(header), _) => Unit::of_noise(&header.noise),
            (None, Some(beside)) => Unit::load(&beside).map_err(words)?,
            (None, None) => return Ok(()),
        };
        let beside = Unit::beside(to);
        std::fs::write(&beside, unit.to_toml().map_err(words)?).map_err(|e| cannot_write(&beside, &e))?;
        if !quiet {
            eprintln!("IMU: its figures in {}", beside.display());
        }
        Ok(())
    }
}
