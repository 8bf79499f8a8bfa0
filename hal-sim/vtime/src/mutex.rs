//! The raw mutex of the simulator.

use core::marker::PhantomData;

use embassy_sync::blocking_mutex::raw::RawMutex;

/// A raw mutex for one thread: no lock, but every use counts as a [`look`](crate::look).
///
/// Where the firmware has `CriticalSectionRawMutex`, which on a host is one lock for all threads. It is
/// not `Sync`: what it guards lives in the scenario, not in a `static`.
#[derive(Debug)]
pub struct LocalRawMutex {
    not_sync: PhantomData<*mut ()>,
}

// SAFETY: neither `Sync` nor `Send`, so that no other thread can lock it; locking it again from the same
// thread is allowed by the trait.
#[allow(unsafe_code, reason = "the trait is unsafe to implement")]
unsafe impl RawMutex for LocalRawMutex {
    #[allow(clippy::declare_interior_mutable_const, reason = "demanded by the trait")]
    const INIT: Self = Self { not_sync: PhantomData };

    fn lock<R>(&self, f: impl FnOnce() -> R) -> R {
        crate::look();
        f()
    }
}
