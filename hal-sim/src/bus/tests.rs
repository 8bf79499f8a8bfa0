//! The drivers on the wires, with their figures.

use core::cell::{Cell, RefCell};
use std::rc::Rc;

use drivers::adis16495::{Adis16495 as AdisDriver, BURST_LEN, Config, DELAY_US};
use drivers::motor::{Duty, MotorDriver, ThreePhase};
use drivers::mt6835::Mt6835 as EncoderDriver;
use drivers::{Error, Imu, Sequence};
use embassy_futures::join::join3;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Ticker, Timer, with_timeout};
use embedded_hal::digital::{InputPin, StatefulOutputPin};
use embedded_hal_async::digital::Wait;
use embedded_hal_async::spi::{ErrorKind, Operation, SpiDevice};
use embedded_io_async::{Read, Write};
use frames::units::{DEG, STANDARD_GRAVITY};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vtime::{Executor, Failure, Level, Order, Stop, now_ns};

use super::*;
use crate::device::{Adis16495, Motion, Mt6835, SensorModel, SpiTarget};

const SECOND: Duration = Duration::from_secs(1);

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Answers with the complement of what it hears; keeps when.
#[derive(Default)]
struct Mirror(Vec<u64>);

impl SpiTarget for Mirror {
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        self.0.push(now_us);
        for (reply, sent) in miso.iter_mut().zip(mosi) {
            *reply = !sent;
        }
    }
}

#[test]
fn a_burst_takes_its_bits_and_others_run_meanwhile() {
    let others = Rc::new(Cell::new(0));
    let counter = others.clone();
    let mut unit = Executor::new();
    unit.spawn("other", Level::Thread, async move {
        loop {
            Timer::after_micros(10).await;
            counter.set(counter.get() + 1);
        }
    });
    let part = Part::new(Mirror::default());
    let mut port = SpiPort::alone(&part, SpiTiming::at(4_000_000));
    let took = unit.block_on(SECOND, async move {
        let mut buffer = [0x55; 40];
        port.transfer_in_place(&mut buffer).await.unwrap();
        assert_eq!(buffer, [0xAA; 40]);
        now_ns()
    });
    // 320 bits at 4 MHz, and 200 ns on either side.
    assert_eq!(took, Ok(80_400));
    assert_eq!(others.get(), 8);
}

#[test]
fn operations_gap_and_latency() {
    let mut unit = Executor::new();
    let timing = SpiTiming {
        setup_ns: 300,
        hold_ns: 100,
        gap_ns: 500,
        latency_ns: 20_000,
        ..SpiTiming::at(1_000_000)
    };
    let part = Part::new(Mirror::default());
    let (mut first, bus) = (SpiPort::alone(&part, timing), SpiBus::new());
    let mut ports = [
        bus.port(&part, timing),
        bus.port(&part, timing),
        bus.port(&part, timing),
    ];
    let ends = unit.block_on(SECOND, async move {
        let (mut read, mut both, mut short) = ([0; 2], [0x0F], [0]);
        let mut operations = [
            Operation::Write(&[1, 2]),
            Operation::Read(&mut read),
            Operation::TransferInPlace(&mut both),
            Operation::Transfer(&mut short, &[0xA0, 0xB0]),
            Operation::DelayNs(5_000),
        ];
        first.transaction(&mut operations).await.unwrap();
        assert_eq!((read, both, short), ([0xFF, 0xFF], [0xF0], [0x5F]));
        // Seven bytes at 1 MHz, five microseconds of delay, chip select and latency.
        assert_eq!(now_ns(), 300 + 56_000 + 5_000 + 100 + 20_000);
        let start_ns = now_ns();
        let [a, b, c] = &mut ports;
        let one = async |port: &mut SpiPort<Mirror>| {
            port.write(&[0; 2]).await.unwrap();
            now_ns() - start_ns
        };
        <[u64; 3]>::from(join3(one(a), one(b), one(c)).await)
    });
    // One after the other: 16.4 µs and a gap of 0.5 µs each; nobody waits for another's latency.
    assert_eq!(ends, Ok([36_400, 53_300, 70_200]));
}

#[test]
fn faults_of_the_bus() {
    let mut unit = Executor::new();
    let part = Part::new(Mirror::default());
    let mut port = SpiPort::alone(&part, SpiTiming::at(1_000_000));
    let parts = part.clone();
    let done = unit.block_on(SECOND, async move {
        parts.set_faults(SpiFaults {
            errors: 1,
            stuck: false,
        });
        assert_eq!(port.write(&[0; 2]).await, Err(SpiError(ErrorKind::Overrun)));
        assert_eq!(port.write(&[0; 2]).await, Ok(()));
        parts.set_faults(SpiFaults { errors: 0, stuck: true });
        let limit = Duration::from_millis(1);
        assert!(with_timeout(limit, port.write(&[0; 2])).await.is_err());
        parts.set_faults(SpiFaults::default());
        // Dropped in flight: heard, and the bus is occupied to its end.
        let start_ns = now_ns();
        assert!(
            with_timeout(Duration::from_micros(5), port.write(&[0; 2]))
                .await
                .is_err()
        );
        assert_eq!(port.write(&[]).await, Ok(()));
        assert_eq!(now_ns() - start_ns, 16_400 + 200 + 400);
        parts.with(|mirror| mirror.0.len())
    });
    assert_eq!(done, Ok(3));
}

#[test]
fn waits_hear_edges_that_come_while_they_wait() {
    let mut unit = Executor::new();
    let line = Line::new(false);
    let world = line.clone();
    unit.spawn("world", Level::World, async move {
        for (at_us, level) in [(10, true), (20, false), (30, true), (31, false), (40, true)] {
            Timer::at(Instant::from_micros(at_us)).await;
            world.set(level);
        }
        world.force(Some(false));
        assert!(world.output().is_set_high().unwrap());
    });
    let mut input = line.input();
    let done = unit.block_on(SECOND, async move {
        let now = || Instant::now().as_micros();
        input.wait_for_low().await.unwrap();
        assert_eq!(now(), 0);
        input.wait_for_high().await.unwrap();
        assert_eq!(now(), 10);
        input.wait_for_rising_edge().await.unwrap();
        assert_eq!(now(), 30);
        assert!(input.is_high().unwrap());
        input.wait_for_any_edge().await.unwrap();
        assert_eq!(now(), 31);
        // Up and down at one instant: an edge has been, the level is gone.
        input.wait_for_falling_edge().await.unwrap();
        assert_eq!(now(), 40);
        assert!(input.is_low().unwrap());
        // Of the rising edges, the capture kept the last.
        let stamp = input.rising().await;
        assert_eq!((stamp.at_ns, stamp.overrun), (40_000, 2));
    });
    assert_eq!(done, Ok(()));
    assert_eq!((line.rose_ns(), line.fell_ns()), (Some(40_000), Some(40_000)));
}

#[test]
fn a_stamp_is_the_edges_not_the_tasks() {
    let mut unit = Executor::new();
    let line = Line::new(false);
    let (world, mut input) = (line.clone(), line.input());
    unit.spawn("world", Level::World, async move {
        for k in 1..=100_u64 {
            vtime::sleep_until_ns(k * 1_000_300).await;
            world.set(true);
            world.set(false);
        }
    });
    let late = Rc::new(Cell::new(0));
    let worst = late.clone();
    unit.spawn("sampling", Level::Thread, async move {
        for k in 1..=100 {
            let stamp = input.rising().await;
            assert_eq!((stamp.at_ns, stamp.overrun), (k * 1_000_300, 0));
            assert_eq!(stamp.instant(), Instant::from_micros(k * 1_000_300 / 1000));
            worst.set(worst.get().max(now_ns() - stamp.at_ns));
        }
    });
    let busy = unit.spawn("busy", Level::Thread, async {
        let mut ticker = Ticker::every(Duration::from_micros(990));
        loop {
            ticker.next().await;
        }
    });
    busy.set_cost(Duration::from_micros(400));
    assert_eq!(unit.run_until(Instant::from_secs(1)), Ok(Stop::Deadline));
    // The task comes up to 400 µs late, and the stamps above were exact.
    assert!((380_000..=400_000).contains(&late.get()), "{}", late.get());
}

#[test]
fn a_loop_around_a_pin_is_found() {
    let mut unit = Executor::new();
    let mut switch = Line::new(false).input();
    unit.spawn(
        "homing",
        Level::Thread,
        async move { while switch.is_low().unwrap() {} },
    );
    let spinning = Failure::Spinning {
        task: "homing",
        at_us: 0,
    };
    assert_eq!(unit.run_until(Instant::MAX), Err(spinning));
}

/// What the sampling task of a unit saw.
#[derive(Debug, Clone, PartialEq, Default)]
struct Seen {
    stamps_ns: Vec<u64>,
    overruns: u64,
    counters: Vec<u16>,
    rates_dps: Vec<f64>,
    lost: u64,
    trace: u64,
}

/// Five seconds of an ADIS16495 at 202.4 Hz with its driver as the application uses it.
fn imu_run(ready: DataReady, seed: u64, order: Order) -> Seen {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let part = Part::new(Adis16495::new(0, 4_000_000));
    let line = Line::new(false);
    let mut unit = Executor::with_order(order);
    // The rate grows by a degree a second, so that a mean tells its interval.
    let motion = |from_us: u64, to_us: u64| Motion {
        rate: [0.0, 0.0, (from_us + to_us) as f64 / 2e6 * DEG],
        force: [0.0, 0.0, STANDARD_GRAVITY],
        temperature_c: 25.0,
    };
    unit.spawn(
        "imu",
        Level::World,
        ready.run(part.clone(), line.clone(), rng(seed), motion),
    );
    let mut imu = AdisDriver::new(SpiPort::alone(&part, SpiTiming::at(4_000_000)), Delay);
    let (mut edge, to) = (line.input(), seen.clone());
    unit.spawn("sampling", Level::Thread, async move {
        imu.reset().await.unwrap();
        imu.identify().await.unwrap();
        imu.self_test().await.unwrap();
        imu.configure(&Config::default()).await.unwrap();
        edge.clear();
        loop {
            let stamp = edge.rising().await;
            let sample = imu.sample().await.unwrap();
            // A page is selected: one transaction of 40 bytes and the stall.
            assert_eq!(now_ns() - stamp.at_ns, 80_400 + 5_000);
            let Sequence::Counter(counter) = sample.sequence else {
                panic!("{sample:?}")
            };
            let mut seen = to.borrow_mut();
            seen.stamps_ns.push(stamp.at_ns);
            seen.overruns += stamp.overrun;
            seen.counters.push(counter);
            seen.rates_dps
                .push(f64::from(sample.rate.0[2]) * imu.scale().rate as f64 / DEG);
        }
    });
    assert_eq!(unit.run_until(Instant::from_micros(5_300_000)), Ok(Stop::Deadline));
    assert_eq!(part.with(|imu| imu.stall_violations()), 0);
    let trace = unit.trace();
    drop(unit);
    let mut seen = seen.take();
    (seen.lost, seen.trace) = (line.lost(), trace);
    seen
}

/// The output period, µs.
const PERIOD_US: f64 = 21.0 / 4250.0 * 1e6;

#[test]
fn the_imu_driver_samples_on_edges() {
    assert_eq!(BURST_LEN, 40);
    let seen = imu_run(DataReady::default(), 1, Order::Fifo);
    // The part is ready after its second start; 5.3 s less 530 ms of start, self-test and settings.
    let n = seen.stamps_ns.len();
    assert_eq!(
        n,
        (5_300_000.0 - seen.stamps_ns[0] as f64 / 1e3) as usize / PERIOD_US as usize + 1
    );
    assert!((960..=1020).contains(&n), "{n}");
    assert!(seen.counters.windows(2).all(|pair| pair[1] == pair[0] + 1));
    let first_us = seen.stamps_ns[0] as f64 / 1e3;
    for (k, (at_ns, rate)) in seen.stamps_ns.iter().zip(&seen.rates_dps).enumerate() {
        let at_us = *at_ns as f64 / 1e3;
        assert!((at_us - first_us - k as f64 * PERIOD_US).abs() <= 1.0);
        // The mean over the sample's own interval: to the microsecond of its ends and a count (9.5e-8 °/s).
        let middle_us = at_us - f64::from(DELAY_US) - PERIOD_US / 2.0;
        assert!((rate - middle_us / 1e6).abs() < 1.2e-6, "{k} {rate}");
    }
}

#[test]
fn jitter_is_the_edges_and_has_its_spread() {
    let jitter = DataReady {
        delay_us: 20.0,
        jitter_sd_us: 4.0,
        ..DataReady::default()
    };
    let (plain, seen) = (
        imu_run(DataReady::default(), 1, Order::Fifo),
        imu_run(jitter, 1, Order::Fifo),
    );
    assert!(seen.counters == plain.counters);
    // The samples are the same, only the edges are late.
    assert!(seen.rates_dps == plain.rates_dps);
    let late_us: Vec<_> = seen
        .stamps_ns
        .iter()
        .zip(&plain.stamps_ns)
        .map(|(late, at)| (late - at) as f64 / 1e3)
        .collect();
    let n = late_us.len() as f64;
    let mean = late_us.iter().sum::<f64>() / n;
    let sd = frames::math::sqrt(late_us.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n);
    // 960 and more edges: the mean to 4/√960 = 0.13, the spread to 0.09; three of each.
    assert!((mean - 20.0).abs() < 0.39, "{mean}");
    assert!((sd - 4.0).abs() < 0.28, "{sd}");
    let cut = late_us.iter().fold(f64::INFINITY, |least, x| least.min(*x));
    assert!(cut > 0.0);
}

#[test]
fn lost_edges_are_counted_exactly() {
    let one_percent = DataReady {
        loss: 0.01,
        ..DataReady::default()
    };
    let seen = imu_run(one_percent, 3, Order::Fifo);
    let gaps: u64 = seen
        .counters
        .windows(2)
        .map(|pair| u64::from(pair[1].wrapping_sub(pair[0]) - 1))
        .sum();
    // Base samples before the settings have edges of their own, which nobody heard either.
    let running = imu_run(DataReady::default(), 3, Order::Fifo).counters.len() as u64;
    assert_eq!(gaps + seen.counters.len() as u64, running);
    assert!(gaps > 0 && gaps <= seen.lost, "{gaps} {}", seen.lost);
    assert_eq!(seen.overruns, 0);
}

#[test]
fn same_seed_same_trace() {
    let jitter = DataReady {
        delay_us: 20.0,
        jitter_sd_us: 4.0,
        loss: 0.01,
        ..DataReady::default()
    };
    let first = imu_run(jitter, 7, Order::Fifo);
    // The same on another thread, at the same time as another run.
    let (again, other) = std::thread::scope(|scope| {
        let again = scope.spawn(move || imu_run(jitter, 7, Order::Fifo));
        let other = scope.spawn(move || imu_run(jitter, 8, Order::Fifo));
        (again.join().unwrap(), other.join().unwrap())
    });
    assert_eq!(first, again);
    assert_ne!(first.trace, other.trace);
}

#[test]
fn edges_missed_by_the_part() {
    let mut unit = Executor::new();
    let part = Part::new(Adis16495::new(0, 4_000_000));
    let (line, edges) = (Line::new(false), Rc::new(Cell::new(0)));
    let ready = DataReady::default();
    unit.spawn(
        "imu",
        Level::World,
        ready.run(part.clone(), line.clone(), rng(0), |_, _| Motion::default()),
    );
    let (mut input, counter) = (line.input(), edges.clone());
    unit.spawn("count", Level::Thread, async move {
        loop {
            input.rising().await;
            counter.set(counter.get() + 1);
        }
    });
    // The part starts after 350 ms, with 4250 samples a second until it is configured.
    unit.run_until(Instant::from_millis(450)).unwrap();
    assert_eq!(edges.get(), 425);
    part.with(|imu| imu.faults().missed_edges = 25);
    unit.run_until(Instant::from_millis(550)).unwrap();
    assert_eq!(edges.get(), 825);
    line.lose_rising(5);
    line.lose_rising(5);
    unit.run_until(Instant::from_millis(650)).unwrap();
    assert_eq!((edges.get(), line.lost()), (1240, 10));
}

#[test]
fn the_encoder_is_read_where_the_shaft_is() {
    let mut unit = Executor::new();
    let part = Part::new(Mt6835::new());
    // 20 °/s, exactly at the instant of the first clock.
    let angle_at = |at_ns: u64| 20.0 * DEG * at_ns as f64 / 1e9;
    part.before(move |encoder, at_ns| encoder.set_angle(angle_at(at_ns)));
    let mut encoder = EncoderDriver::new(SpiPort::alone(&part, SpiTiming::at(8_000_000)));
    let done = unit.block_on(SECOND * 2, async move {
        encoder.identify().await.unwrap();
        let mut ticker = Ticker::every(Duration::from_hz(2000));
        for _ in 0..2000 {
            ticker.next().await;
            let start_ns = now_ns();
            let reading = encoder.read().await.unwrap();
            // Six bytes at 8 MHz.
            assert_eq!(now_ns() - start_ns, 6_400);
            let off = f64::from(reading.angle.radians()) - angle_at(start_ns + 200);
            assert!(off.abs() < 1.7e-6, "{off:e}");
        }
    });
    assert_eq!(done, Ok(()));
}

#[test]
fn a_silent_part_is_an_error_not_a_hang() {
    let mut unit = Executor::new();
    let part = Part::new(Adis16495::new(0, 4_000_000));
    let line = Line::new(false);
    let mut imu = AdisDriver::new(SpiPort::alone(&part, SpiTiming::at(4_000_000)), Delay);
    part.with(|imu| imu.faults.silent = Some(0xFF));
    let mut edge = line.input();
    let done = unit.block_on(SECOND, async move {
        assert_eq!(imu.sample().await, Err(Error::Silent { level: 0xFF }));
        let silence = with_timeout(Duration::from_millis(20), edge.rising());
        assert!(silence.await.is_err());
        now_ns()
    });
    // Page selection, burst, and the wait.
    assert!(done.is_ok_and(|at_ns| (20_090_000..20_110_000).contains(&at_ns)));
}

#[test]
fn motor_off_within_the_instant_of_the_fault() {
    let mut unit = Executor::new();
    let (enable, n_fault) = (Line::new(false), Line::new(true));
    let (mut timer, mut monitor) = pwm(50_000);
    let mut driver = MotorDriver::new(enable.output(), n_fault.input()).unwrap();
    let mut fault = n_fault.input();
    unit.spawn("motor", Level::Interrupt, async move {
        driver.enable().unwrap();
        let mut ticker = Ticker::every(Duration::from_hz(2000));
        for k in 0.. {
            match select(ticker.next(), fault.wait_for_low()).await {
                Either::First(()) => timer.set_duties([Duty::new(k as f32 / 100.0), Duty::HALF, Duty::HALF]),
                Either::Second(_) => {
                    timer.outputs_off();
                    driver.disable().unwrap();
                    return;
                }
            }
        }
    });
    let thermal = n_fault.clone();
    unit.spawn("bridge", Level::World, async move {
        Timer::after_micros(2_010).await;
        thermal.set(false);
    });
    assert_eq!(unit.run_until(Instant::from_millis(3)), Ok(Stop::Finished));
    assert_eq!(enable.fell_ns(), Some(2_010_000));
    assert!(!enable.level());
    let changes: Vec<_> = core::iter::from_fn(|| monitor.next_until(3_000_000)).collect();
    let at = |changes: &[PwmChange]| changes.iter().map(|change| change.at_ns).collect::<Vec<_>>();
    // Each at the period after its tick; those of the last tick would have come after the fault.
    assert_eq!(at(&changes), [550_000, 1_050_000, 1_550_000, 2_010_000]);
    assert_eq!(changes[1].duties, Some([Duty::new(0.01), Duty::HALF, Duty::HALF]));
    assert_eq!((changes[3].duties, monitor.current()), (None, changes[3]));
}

#[test]
fn the_last_duties_of_a_period_count() {
    let mut unit = Executor::new();
    let (mut timer, mut monitor) = pwm(50_000);
    let done = unit.block_on(SECOND, async move {
        timer.set_duties([Duty::OFF; 3]);
        Timer::after_micros(20).await;
        timer.set_duties([Duty::HALF; 3]);
        Timer::after_micros(60).await;
        let first = monitor.next_until(now_ns());
        assert_eq!(
            first,
            Some(PwmChange {
                at_ns: 50_000,
                duties: Some([Duty::HALF; 3])
            })
        );
        timer.set_duties([Duty::OFF; 3]);
        // Not yet.
        assert_eq!(monitor.next_until(now_ns()), None);
    });
    assert_eq!(done, Ok(()));
}

#[test]
fn uart_at_115200() {
    let mut unit = Executor::new();
    let (mut rx, mut tx, mut host) = uart(UartConfig::default(), rng(0));
    let done = unit.block_on(SECOND, async move {
        // 11 520 bytes a second: 1152 bytes are 100 ms, of which the first 1024 are taken at once.
        let text = [b'x'; 1152];
        tx.write_all(&text).await.unwrap();
        let accepted_ns = now_ns();
        // The 128 bytes beyond the buffer wait for as many to leave.
        assert!((11_100_000..11_120_000).contains(&accepted_ns), "{accepted_ns}");
        tx.flush().await.unwrap();
        assert!((99_990_000..=100_000_000).contains(&now_ns()), "{}", now_ns());
        let received = host.received();
        assert_eq!(received.len(), 1152);
        assert!((86_805..=86_806).contains(&(received[1].0 - received[0].0)));

        let start_ns = now_ns();
        host.send(b"$PRN,START\r\n");
        let (mut line, mut buffer) = (Vec::new(), [0; 64]);
        while line.last() != Some(&b'\n') {
            let n = rx.read(&mut buffer).await.unwrap();
            line.extend_from_slice(&buffer[..n]);
        }
        assert_eq!(line, b"$PRN,START\r\n");
        assert_eq!(now_ns() - start_ns, 12 * 86_805);
        assert_eq!(rx.read(&mut []).await, Ok(0));

        // Lines, one of them in two parts.
        tx.write_all(b"$GPTHS,12").await.unwrap();
        assert!(with_timeout(Duration::from_millis(5), host.line()).await.is_err());
        tx.write_all(b"3.4,A\r\n$GPHDT\r\n").await.unwrap();
        let first = host.line().await;
        assert_eq!(first.bytes, b"$GPTHS,123.4,A\r\n");
        assert_eq!(now_ns(), first.ended_ns);
        assert_eq!(host.line().await.bytes, b"$GPHDT\r\n");
    });
    assert_eq!(done, Ok(()));
}

#[test]
fn uart_faults() {
    let mut unit = Executor::new();
    let config = UartConfig {
        rx_buffer: 16,
        ..UartConfig::default()
    };
    let (mut rx, mut tx, mut host) = uart(config, rng(5));
    let done = unit.block_on(SECOND * 10, async move {
        let mut buffer = [0; 64];
        host.set_faults(UartFaults {
            bad_to_unit: 1,
            framing_to_unit: 1,
            ..UartFaults::default()
        });
        host.send(b"ab");
        assert_eq!(rx.read(&mut buffer).await, Err(UartError::Framing));
        assert_eq!((rx.read(&mut buffer).await, buffer[0]), (Ok(1), b'b'));
        host.set_faults(UartFaults {
            bad_to_unit: 1,
            ..UartFaults::default()
        });
        host.send(b"ab");
        assert_eq!(rx.read(&mut buffer).await, Ok(1));
        assert_eq!((buffer[0] ^ b'a').count_ones(), 1);
        assert_eq!((rx.read(&mut buffer).await, buffer[0]), (Ok(1), b'b'));

        // Nobody reads: sixteen bytes are kept, the others counted, the loss reported in its place.
        host.send(&[b'x'; 20]);
        Timer::after_millis(5).await;
        assert_eq!(rx.read(&mut buffer).await, Ok(16));
        assert_eq!(host.overruns(), 4);
        assert_eq!(rx.read(&mut buffer).await, Err(UartError::Overrun));

        host.set_faults(UartFaults {
            flip_to_host: 0.1,
            ..UartFaults::default()
        });
        tx.write_all(&[b'x'; 10_000]).await.unwrap();
        tx.flush().await.unwrap();
        let bad = host.received().iter().filter(|(_, byte)| *byte != b'x').count();
        // A thousand, to three times √900.
        assert!((910..1090).contains(&bad), "{bad}");

        host.set_faults(UartFaults {
            cut: true,
            ..UartFaults::default()
        });
        host.send(b"ab");
        tx.write_all(b"ab").await.unwrap();
        tx.flush().await.unwrap();
        let silence = with_timeout(Duration::from_millis(5), rx.read(&mut buffer));
        assert!(silence.await.is_err());
        assert!(host.received().is_empty());
    });
    assert_eq!(done, Ok(()));
}

/// Everything a unit has on its wires, at its rates.
fn unit_run(seed: u64, seconds: u64) -> (u64, u64) {
    let imu = Part::new(Adis16495::new(0, 4_000_000));
    let encoder = Part::new(Mt6835::new());
    encoder.before(|encoder, at_ns| encoder.set_angle(at_ns as f64 * 3e-10));
    let line = Line::new(false);
    let (mut timer, _monitor) = pwm(50_000);
    let (mut rx, mut tx, mut host) = uart(UartConfig::default(), rng(seed));
    let ready = DataReady {
        delay_us: 20.0,
        jitter_sd_us: 4.0,
        ..DataReady::default()
    };
    let mut unit = Executor::with_order(Order::Shuffled(seed));
    unit.spawn(
        "imu",
        Level::World,
        ready.run(imu.clone(), line.clone(), rng(seed), |_, _| Motion::default()),
    );
    unit.spawn("host", Level::World, async move {
        loop {
            vtime::mark(host.line().await.ended_ns);
        }
    });
    let mut driver = EncoderDriver::new(SpiPort::alone(&encoder, SpiTiming::at(8_000_000)));
    unit.spawn("motor", Level::Interrupt, async move {
        let mut ticker = Ticker::every(Duration::from_hz(2000));
        loop {
            ticker.next().await;
            let angle = driver.read().await.unwrap().angle.radians();
            timer.set_duties([Duty::new(angle); 3]);
        }
    });
    let mut driver = AdisDriver::new(SpiPort::alone(&imu, SpiTiming::at(4_000_000)), Delay);
    let mut edge = line.input();
    unit.spawn("sampling", Level::Thread, async move {
        driver.reset().await.unwrap();
        driver.configure(&Config::default()).await.unwrap();
        loop {
            with_timeout(Duration::from_millis(20), edge.rising()).await.unwrap();
            driver.sample().await.unwrap();
        }
    });
    unit.spawn("output", Level::Thread, async move {
        let mut ticker = Ticker::every(Duration::from_hz(10));
        loop {
            ticker.next().await;
            tx.write_all(b"$GPTHS,123.45,A*00\r\n").await.unwrap();
        }
    });
    unit.spawn("commands", Level::Thread, async move {
        let mut buffer = [0; 64];
        while rx.read(&mut buffer).await.is_ok() {}
    });
    assert_eq!(unit.run_until(Instant::from_secs(seconds)), Ok(Stop::Deadline));
    (unit.trace(), unit.polls())
}

#[test]
fn a_whole_unit_runs_fast_and_the_same() {
    let start = std::time::Instant::now();
    let (trace, polls) = unit_run(1, 60);
    let ratio = 60.0 / start.elapsed().as_secs_f64();
    println!("{ratio:.0} times real time, {polls} polls");
    assert_eq!(unit_run(1, 60), (trace, polls));
    assert_ne!(unit_run(2, 60).0, trace);
    // About 1000; the limit is for a loaded machine. The issue wants 50 for everything.
    assert!(ratio > 150.0, "{ratio}");
}
