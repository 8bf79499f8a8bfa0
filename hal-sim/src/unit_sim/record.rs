//! The unit's log on a host: lines with virtual time, kept by the thread that runs the unit.

use core::cell::RefCell;
use std::sync::Once;

use serde::Serialize;
use vtime::now_ns;

/// A line of the log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Line {
    /// Virtual time since power-up, µs.
    pub t_us: u64,
    /// Its level.
    #[serde(serialize_with = "as_text")]
    pub level: log::Level,
    /// Its text.
    pub text: String,
}

fn as_text<S: serde::Serializer>(level: &log::Level, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(level.as_str())
}

impl core::fmt::Display for Line {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (s, us) = (self.t_us / 1_000_000, self.t_us % 1_000_000);
        write!(f, "[{s:>5}.{us:06}] {:<5} {}", self.level, self.text)
    }
}

/// Gets each line as it comes.
pub(super) type Sink = Box<dyn FnMut(Line)>;

thread_local! {
    static SINK: RefCell<Option<Sink>> = const { RefCell::new(None) };
}

struct ThreadLogger;

impl log::Log for ThreadLogger {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.target().starts_with("app")
    }

    fn log(&self, record: &log::Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        SINK.with_borrow_mut(|sink| {
            if let Some(sink) = sink {
                sink(Line {
                    t_us: now_ns() / 1000,
                    level: record.level(),
                    text: record.args().to_string(),
                });
            }
        });
    }

    fn flush(&self) {}
}

/// Lets the lines of this thread go to `sink`, until dropped.
pub(super) struct Recording;

impl Recording {
    pub(super) fn to(sink: Sink) -> Self {
        static LOGGER: ThreadLogger = ThreadLogger;
        static ONCE: Once = Once::new();
        ONCE.call_once(|| {
            // Another logger in the process has its reasons; then the log stays empty.
            if log::set_logger(&LOGGER).is_ok() {
                log::set_max_level(log::LevelFilter::Trace);
            }
        });
        SINK.set(Some(sink));
        Self
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        SINK.set(None);
    }
}
