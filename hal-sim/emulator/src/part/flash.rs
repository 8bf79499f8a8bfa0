//! Flash that can be erased and written: RM0090 rev 22 chapter 3.
//!
//! rigless's interface has the registers: keys, erase times, errors of an erase, interrupt. Its array is read-only,
//! stores are dropped and an erase changes nothing. Here the whole array, both banks, is one that a model programs:
//!
//! ```text
//! store ─► core: read-only page ─► session: nobody takes it ─► Part::correct ─► Interface::store: PG, PSIZE, nWRP?
//!                                                                             └► old & value into the array
//! CR.STRT ─► rigless's interface: BSY, time, EOP ─► Interface: which sectors ─► Part::correct ─► 0xFF into the array
//! ```
//!
//! The session lists such a store among the accesses that nobody takes; [`in_array`] tells it from the others.
//!
//! | | |
//! |---|---|
//! | programming | clears bits, never sets one; BSY for [`PROGRAM_NS`], then EOP where EOPIE is set |
//! | PGSERR | a store without PG, or with SER, MER or MER1 beside it |
//! | PGPERR | a store of another width than PSIZE says |
//! | PGAERR | a store across a row of 128 bits |
//! | WRPERR | a store into a sector that nWRP or SPRMOD protects |
//! | erase | sets every bit of the sector, the bank or both |
//! | reset or power cut | contents and option bytes stay; of the bits that were about to change, each has or has not |
//!
//! Not modelled: the stall of a bank while it is busy, therefore contents are new from the beginning of an operation
//! on, which is what the core would read at the stall's end; a store while another is under way prolongs BSY in place
//! of the stall. Wear, disturbance, cells that read now this way and now that after a cut. An erase takes the typical
//! time of the datasheet, not the longest. Caches that hold what is no longer there. Stores by the alias at 0: they are
//! dropped.

use core::ops::Range;
use std::num::NonZeroU32;

use rigless::device::{self, Device, DeviceContext, RegisterFile, ResetCause};
use rigless::emulator::{Access, Memory};
use rigless::mcu::Mcu;
use rigless::soc::stm32f427::MEMORY;
use rigless::soc::stm32f427::generated::flash::{Register, cr, optcr, optcr1, sr};
use rigless::soc::stm32f427::peripherals::flash::{Flash, STRT};
use rigless::soc::{Bus, Error, FieldSpec, Region, Width};
use rigless::time::{EventId, VirtualNanos};

/// The array.
const ARRAY: Range<u64> = 0x0800_0000..0x0820_0000;
/// Time of a program operation of any width, ns: DS9405 rev 13 table 48, typical.
const PROGRAM_NS: u64 = 16_000;
/// Bytes of a row that a program operation stays within.
const ROW: u64 = 16;
/// HCLK after a reset, Hz.
const RESET_HZ: u64 = 16_000_000;
/// Sectors of a bank.
const BANK: u64 = 12;

/// Whether an address is in the array. An access there that no model answers is a store, which [`Interface`] takes.
pub(crate) fn in_array(address: u64) -> bool {
    ARRAY.contains(&address)
}

/// Sector 0 to 23: four of 16 kB, one of 64, seven of 128 in each bank; table 6.
fn sector(index: u64) -> Range<u64> {
    const KB: u64 = 1024;
    let base = ARRAY.start + index / BANK * 1024 * KB;
    let (from, size) = match index % BANK {
        k @ 0..4 => (16 * k, 16),
        4 => (64, 64),
        k => (128 * (k - 4), 128),
    };
    base + from * KB..base + (from + size) * KB
}

/// Whether an option byte keeps a sector from being changed.
fn protected(index: u64, registers: &RegisterFile) -> bool {
    let options = registers.get(Register::Optcr);
    let (words, bit) = if index < BANK {
        (optcr::NWRP.get(options), index)
    } else {
        (optcr1::NWRP.get(registers.get(Register::Optcr1)), index - BANK)
    };
    optcr::SPRMOD.is_set(options) == (words >> bit & 1 == 1)
}

/// Contents before an operation.
#[derive(Debug)]
struct Before {
    address: u64,
    bytes: Vec<u8>,
}

impl Before {
    fn of<M: Memory + ?Sized>(memory: &mut M, range: Range<u64>) -> Self {
        let address = range.start;
        let bytes = range
            .flat_map(|address| memory.read(address, Width::W8))
            .map(|byte| byte as u8);
        Self {
            address,
            bytes: bytes.collect(),
        }
    }
}

/// Puts bytes into the array, where they differ from what is there.
fn put<M: Memory + ?Sized>(memory: &mut M, address: u64, bytes: &[u8]) {
    let mut program = |address, width, value| {
        if memory.read(address, width).ok() != Some(value) {
            // The array is laid out as one that is programmed.
            let _ = memory.program(address, width, value);
        }
    };
    for (address, chunk) in (address..).step_by(8).zip(bytes.chunks(8)) {
        if let Ok(word) = chunk.try_into() {
            program(address, Width::W64, u64::from_le_bytes(word));
            continue;
        }
        for (address, byte) in (address..).zip(chunk) {
            program(address, Width::W8, u64::from(*byte));
        }
    }
}

/// The interface, with its array.
#[derive(Debug)]
pub(super) struct Interface {
    inner: Flash,
    /// Sectors whose erase has begun, not erased yet.
    begun: Vec<Range<u64>>,
    /// What the operations under way have replaced.
    under_way: Vec<Before>,
    /// What operations had replaced that a reset has broken off.
    broken_off: Vec<Before>,
    erasing: bool,
    /// The end of the program operations under way.
    ends: Option<(EventId, VirtualNanos)>,
    /// Ends that later stores have put off.
    stale: Vec<EventId>,
}

impl Interface {
    pub(super) fn new(supply_mv: u32) -> Self {
        let mut inner = Flash::with_clock(RESET_HZ);
        if let Some(supply) = NonZeroU32::new(supply_mv) {
            inner.set_supply(supply);
        }
        Self {
            inner,
            begun: Vec::new(),
            under_way: Vec::new(),
            broken_off: Vec::new(),
            erasing: false,
            ends: None,
            stale: Vec::new(),
        }
    }

    /// The interface after a reset: the array and the option bytes stay, an operation does not come to its end.
    pub(super) fn restart(&mut self, supply_mv: u32, registers: &mut RegisterFile) {
        let (optcr, optcr1) = self.inner.committed_options();
        let mut fresh = Self::new(supply_mv);
        fresh.inner.keep_options(optcr, optcr1, registers);
        fresh.broken_off.append(&mut self.broken_off);
        fresh.broken_off.append(&mut self.under_way);
        *self = fresh;
    }

    /// A store into the array.
    pub(super) fn store<M: Memory + ?Sized>(
        &mut self,
        access: &Access,
        memory: &mut M,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let size = u64::from(access.width.bytes());
        let range = access.address..access.address + size;
        if let Some(error) = refusal(&range, registers) {
            let control = registers.get(Register::Cr);
            let mut status = error.set(registers.get(Register::Sr), 1);
            if cr::ERRIE.is_set(control) {
                status = sr::OPERR.set(status, 1);
            }
            registers.set(Register::Sr, status);
            self.refresh(registers, context);
            return;
        }
        let before = Before::of(memory, range);
        let value = access.value.to_le_bytes();
        let after: Vec<u8> = before.bytes.iter().zip(value).map(|(old, new)| old & new).collect();
        put(memory, before.address, &after);
        self.under_way.push(before);
        let from = self.ends.map_or(context.now(), |(_, end)| end.max(context.now()));
        let end = VirtualNanos(from.0 + PROGRAM_NS);
        if let Some((event, _)) = self.ends.replace((context.schedule(end), end)) {
            self.stale.push(event);
        }
    }

    /// Does to the array what an access or an event has left to do.
    pub(super) fn serve<M: Memory + ?Sized>(&mut self, at: VirtualNanos, memory: &mut M) {
        for before in self.broken_off.drain(..) {
            let mut word = at.0 | 1;
            let now = Before::of(memory, before.address..before.address + before.bytes.len() as u64);
            let mixed = before.bytes.iter().zip(now.bytes).map(|(old, new)| {
                word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                new ^ ((old ^ new) & (word >> 32) as u8)
            });
            put(memory, before.address, &mixed.collect::<Vec<_>>());
        }
        for range in self.begun.drain(..) {
            let before = Before::of(memory, range);
            put(memory, before.address, &vec![0xFF; before.bytes.len()]);
            self.under_way.push(before);
        }
    }

    /// Takes note of an erase that has begun.
    fn note_erase(&mut self, registers: &RegisterFile) {
        let (status, control) = (registers.get(Register::Sr), registers.get(Register::Cr));
        if self.erasing || !sr::BSY.is_set(status) || !STRT.is_set(control) {
            return;
        }
        self.erasing = true;
        let banks = [(cr::MER, 0..BANK), (cr::MER1, BANK..2 * BANK)];
        let mass: Vec<_> = banks.into_iter().filter(|(bit, _)| bit.is_set(control)).collect();
        if mass.is_empty() {
            // Bit 4 is the bank; rigless has refused the numbers between.
            let number = cr::SNB.get(control);
            self.begun.push(sector(number - number / 16 * (16 - BANK)));
        }
        for (_, sectors) in mass {
            self.begun.extend(sectors.map(sector));
        }
    }

    /// Drives the interrupt by the flags.
    fn refresh(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        // What rigless's interface does at a write of SR when the flags have been cleared.
        self.inner.write(Register::Sr, 0, registers, context);
    }
}

/// Why the interface does not take a store.
fn refusal(range: &Range<u64>, registers: &RegisterFile) -> Option<&'static FieldSpec> {
    let control = registers.get(Register::Cr);
    let erases = [cr::SER, cr::MER, cr::MER1].iter().any(|bit| bit.is_set(control));
    let at = |address: u64| (0..2 * BANK).find(|index| sector(*index).contains(&address));
    if !cr::PG.is_set(control) || erases {
        Some(sr::PGSERR)
    } else if range.end - range.start != 1 << cr::PSIZE.get(control) {
        Some(sr::PGPERR)
    } else if range.start / ROW != (range.end - 1) / ROW {
        Some(sr::PGAERR)
    } else if at(range.start).is_none_or(|index| protected(index, registers)) {
        Some(sr::WRPERR)
    } else {
        None
    }
}

impl Device for Interface {
    type Register = Register;

    fn read(&mut self, register: Register, registers: &mut RegisterFile, _: &mut DeviceContext<'_>) -> Option<u64> {
        // Not in the register: rigless's interface would hold back what is written meanwhile, and never let it go.
        let status = registers.get(Register::Sr);
        (register == Register::Sr && self.ends.is_some()).then(|| sr::BSY.set(status, 1))
    }

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.write(register, value, registers, context);
        self.note_erase(registers);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.stale.contains(&event) {
            self.stale.retain(|stale| *stale != event);
            return;
        }
        if self.ends.is_some_and(|(end, _)| end == event) {
            self.ends = None;
            if !self.erasing {
                self.under_way.clear();
            }
            if cr::EOPIE.is_set(registers.get(Register::Cr)) {
                registers.set(Register::Sr, sr::EOP.set(registers.get(Register::Sr), 1));
            }
            self.refresh(registers, context);
            return;
        }
        if core::mem::take(&mut self.erasing) {
            self.under_way.clear();
        }
        self.inner.on_event(event, registers, context);
        self.note_erase(registers);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.on_clock(hz, registers, context);
    }
}

/// rigless's regions, the flash array one that is programmed.
static REGIONS: [Region; MEMORY.len()] = {
    let mut regions = MEMORY;
    assert!(regions[0].base == ARRAY.start && regions[0].size == ARRAY.end - ARRAY.start);
    regions[0] = regions[0].programmed_by("FLASH");
    regions
};

/// What the emulator lays out the memory by: the part's description, and nothing that runs.
///
/// It asks a target once, before the first instruction; what it runs is [`Part`](super::Part), whose own bus has the
/// array as read-only memory.
#[derive(Debug)]
pub(crate) struct MemoryMap {
    bus: Bus,
}

impl MemoryMap {
    /// The description of the part whose bus it is.
    ///
    /// # Errors
    /// Where it does not assemble.
    pub(crate) fn of(bus: &Bus) -> Result<Self, Error> {
        let instances: Vec<_> = bus.peripherals().copied().collect();
        let bus = Bus::builder(bus.cpu(), &REGIONS, instances).build()?;
        Ok(Self { bus })
    }
}

impl Mcu for MemoryMap {
    fn bus(&self) -> &Bus {
        &self.bus
    }

    fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    fn reset(&mut self, _: VirtualNanos, _: ResetCause) {}

    fn poll(&mut self, _: VirtualNanos) {}

    fn split(&mut self, _: usize) -> (&mut Bus, Option<&mut dyn device::ErasedDevice>) {
        (&mut self.bus, None)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use rigless::emulator::{AccessKind, Error as EmulatorError, Settled, Stop, StopReason};
    use rigless::mcu::Operate as _;

    use super::*;
    use crate::part::{BridgeTimer, Part};

    const KEYR: u64 = 0x4002_3C04;
    const OPTKEYR: u64 = KEYR + 4;
    const SR: u64 = KEYR + 8;
    const CR: u64 = KEYR + 12;
    const OPTCR1: u64 = KEYR + 20;

    /// PG with PSIZE for words of 32 bits.
    const PG: u64 = 1 | 2 << 8;
    const SER: u64 = 1 << 1;
    const MER1: u64 = 1 << 15;
    const START: u64 = 1 << 16;
    const EOPIE: u64 = 1 << 24;
    const BSY: u64 = 1 << 16;
    const EOP: u64 = 1;
    const WRPERR: u64 = 1 << 4;
    const PGAERR: u64 = 1 << 5;
    const PGPERR: u64 = 1 << 6;
    const PGSERR: u64 = 1 << 7;
    /// Sector 12 in SNB.
    const SNB_12: u64 = 16 << 3;
    const SETTINGS: u64 = 0x0810_0000;
    /// Erase of 16 kB with PSIZE as a reset leaves it, ns.
    const ERASE_NS: u64 = 400_000_000;

    /// The array alone.
    struct Array(Vec<u8>);

    impl Array {
        fn at(&mut self, address: u64, width: Width) -> &mut [u8] {
            let from = (address - ARRAY.start) as usize;
            &mut self.0[from..from + width.bytes() as usize]
        }
    }

    impl Memory for Array {
        fn read(&mut self, address: u64, width: Width) -> Result<u64, EmulatorError> {
            Ok(self
                .at(address, width)
                .iter()
                .rev()
                .fold(0, |word, byte| word << 8 | u64::from(*byte)))
        }

        fn write(&mut self, address: u64, width: Width, _: u64) -> Result<(), EmulatorError> {
            Err(EmulatorError::Memory { address, width })
        }

        fn program(&mut self, address: u64, width: Width, value: u64) -> Result<(), EmulatorError> {
            let bytes = value.to_le_bytes();
            let at = self.at(address, width);
            at.copy_from_slice(&bytes[..at.len()]);
            Ok(())
        }
    }

    /// A part, driven as the runtime drives it.
    struct Bench {
        part: Part,
        array: Array,
        at: VirtualNanos,
    }

    impl Bench {
        fn new() -> Self {
            Self {
                part: Part::new(8_000_000, 3300, BridgeTimer::Quiet).unwrap(),
                array: Array(vec![0xFF; (ARRAY.end - ARRAY.start) as usize]),
                at: VirtualNanos(0),
            }
        }

        fn write(&mut self, address: u64, width: Width, value: u64) {
            let served = self.part.write(self.at, address, width, value);
            assert_eq!(served.is_err(), in_array(address));
            self.part.settle(&mut self.array).unwrap();
            let access = Access::new(AccessKind::Write, address, width, value).at(0, self.at);
            self.part.correct(&Settled::Access { access, value }, &mut self.array);
        }

        fn set(&mut self, register: u64, value: u64) {
            self.write(register, Width::W32, value);
        }

        fn store(&mut self, address: u64, value: u64) {
            self.write(address, Width::W32, value);
        }

        fn word(&mut self, address: u64) -> u64 {
            self.array.read(address, Width::W32).unwrap()
        }

        fn status(&mut self) -> u64 {
            self.part.read(self.at, SR, Width::W32).unwrap()
        }

        /// The flags, cleared.
        fn flags(&mut self) -> u64 {
            let status = self.status();
            self.set(SR, status);
            status
        }

        fn stop(&mut self) {
            let stop = Stop {
                at: self.at,
                instruction_count: 0,
                reason: StopReason::Deadline,
            };
            self.part.correct(&Settled::Stop(stop), &mut self.array);
        }

        fn wait(&mut self, ns: u64) {
            self.at = VirtualNanos(self.at.0 + ns);
            self.part.advance_to(self.at);
            self.part.settle(&mut self.array).unwrap();
            self.stop();
        }

        fn reset(&mut self, cause: ResetCause) {
            self.part.reset(self.at, cause);
            self.stop();
        }

        fn unlock(&mut self) {
            self.set(KEYR, 0x4567_0123);
            self.set(KEYR, 0xCDEF_89AB);
        }

        fn erase(&mut self, what: u64) {
            self.set(CR, what);
            self.set(CR, what | START);
        }

        fn fill(&mut self, address: u64, length: u64, byte: u8) {
            let from = (address - ARRAY.start) as usize;
            self.array.0[from..from + length as usize].fill(byte);
        }
    }

    #[test]
    fn sectors_lie_end_to_end() {
        let mut end = ARRAY.start;
        for index in 0..2 * BANK {
            let range = sector(index);
            assert_eq!(range.start, end, "{index}");
            end = range.end;
        }
        assert_eq!(end, ARRAY.end);
        // memory.x: SETTINGS is sectors 12 to 15.
        assert_eq!(sector(12).start..sector(15).end, crate::board::SETTINGS);
    }

    #[test]
    fn a_store_clears_bits_and_takes_its_time() {
        let mut bench = Bench::new();
        bench.unlock();
        bench.set(CR, PG | EOPIE);
        bench.store(SETTINGS, 0xFF00_F0F0);
        assert_eq!(bench.status(), BSY);
        bench.wait(PROGRAM_NS - 1);
        assert_eq!(bench.status(), BSY);
        bench.wait(1);
        assert_eq!(bench.flags(), EOP);
        bench.store(SETTINGS, 0x0FF0_FF00);
        assert_eq!(bench.word(SETTINGS), 0x0F00_F000);
        // One that comes before the end of the other is done after it.
        bench.store(SETTINGS + 4, 0x1234_5678);
        bench.wait(2 * PROGRAM_NS - 1);
        assert_eq!(bench.status(), BSY);
        bench.wait(1);
        assert_eq!(bench.flags(), EOP);
        assert_eq!(bench.word(SETTINGS + 4), 0x1234_5678);
    }

    #[test]
    fn a_store_is_refused_with_its_error() {
        let mut bench = Bench::new();
        bench.store(SETTINGS, 0);
        assert_eq!(bench.flags(), PGSERR);
        bench.unlock();
        bench.set(CR, PG | SER);
        bench.store(SETTINGS, 0);
        assert_eq!(bench.flags(), PGSERR);
        bench.set(CR, PG);
        bench.write(SETTINGS, Width::W8, 0);
        assert_eq!(bench.flags(), PGPERR);
        bench.store(SETTINGS + 14, 0);
        assert_eq!(bench.flags(), PGAERR);
        bench.set(OPTKEYR, 0x0819_2A3B);
        bench.set(OPTKEYR, 0x4C5D_6E7F);
        bench.set(OPTCR1, 0x0FFE_0000);
        bench.store(SETTINGS, 0);
        assert_eq!(bench.flags(), WRPERR);
        assert_eq!(bench.status(), 0);
        assert!(bench.array.0.iter().all(|byte| *byte == 0xFF));
    }

    #[test]
    fn an_erase_sets_its_sector_and_no_other() {
        let mut bench = Bench::new();
        bench.fill(SETTINGS - 16, 0x4000 + 32, 0);
        bench.unlock();
        bench.erase(SER | SNB_12 | EOPIE);
        assert_eq!(bench.status(), BSY);
        bench.wait(ERASE_NS);
        assert_eq!(bench.flags(), EOP);
        let erased = bench.array.0.iter().enumerate().filter(|(_, byte)| **byte == 0);
        let kept: Vec<u64> = erased.map(|(offset, _)| ARRAY.start + offset as u64).collect();
        let expected: Vec<u64> = (SETTINGS - 16..SETTINGS)
            .chain(SETTINGS + 0x4000..SETTINGS + 0x4010)
            .collect();
        assert_eq!(kept, expected);

        bench.erase(MER1);
        bench.wait(16 * 1_000_000_000);
        assert_eq!(bench.status(), 0);
        assert_eq!(bench.word(SETTINGS - 4), 0);
        assert_eq!(bench.word(SETTINGS + 0x4000), 0xFFFF_FFFF);
    }

    /// After the end of an operation a reset changes nothing; before it, bits have changed and others not.
    #[test]
    fn what_a_reset_breaks_off_is_half_done() {
        for cause in [ResetCause::Core, ResetCause::PowerOn] {
            let mut bench = Bench::new();
            bench.unlock();
            bench.set(CR, PG);
            bench.store(SETTINGS, 0x1234_5678);
            bench.wait(PROGRAM_NS);
            bench.reset(cause);
            assert_eq!(bench.word(SETTINGS), 0x1234_5678);
            // Locked again, by the reset.
            bench.store(SETTINGS, 0);
            assert_eq!(bench.flags(), PGSERR);

            bench.unlock();
            bench.set(CR, PG);
            bench.store(SETTINGS + 4, 0);
            bench.wait(PROGRAM_NS / 2);
            bench.reset(cause);
            let word = bench.word(SETTINGS + 4);
            assert!(word != 0 && word != 0xFFFF_FFFF, "{word:#x}");

            bench.fill(SETTINGS, 0x4000, 0);
            bench.unlock();
            bench.erase(SER | SNB_12);
            bench.wait(ERASE_NS / 2);
            bench.reset(cause);
            let ones: u32 = bench.array.0[0x10_0000..0x10_4000]
                .iter()
                .map(|byte| byte.count_ones())
                .sum();
            let share = f64::from(ones) / f64::from(0x4000 * u8::BITS);
            assert!((0.45..0.55).contains(&share), "{share}");
            assert_eq!(bench.status(), 0);

            bench.unlock();
            bench.erase(SER | SNB_12);
            bench.wait(ERASE_NS);
            bench.reset(cause);
            assert!(bench.array.0[0x10_0000..0x10_4000].iter().all(|byte| *byte == 0xFF));
        }
    }
}
