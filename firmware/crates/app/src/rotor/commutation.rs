//! From a voltage in rotor axes to three duties.
//!
//! ```text
//! v_α = v_d cos θ − v_q sin θ          v_a = v_α
//! v_β = v_d sin θ + v_q cos θ          v_b, v_c = −v_α/2 ± √3/2 v_β
//! v_0 = −(max + min)/2                 duty = 1/2 + (v + v_0)/U
//! ```
//!
//! The common voltage `v_0` (min-max injection, the space-vector modulation written without sectors) does not reach the
//! windings of a star and lets the amplitude go to U/√3 instead of U/2.
//!
//! Sine and cosine are those of [`frames::math`]: at 59 instructions there is nothing to gain from an approximate pair.

use drivers::motor::Duty;
use frames::math;

/// Greatest amplitude of a phase as a share of the supply, 1/√3.
pub const LINEAR_RANGE: f32 = 0.577_350_26;

/// How the motor's wires are connected to the bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PhaseOrder {
    /// A field that turns from A to B to C turns the rotor towards greater angles.
    #[default]
    Abc,
    /// It turns it the other way: B and C are exchanged on the way out.
    Acb,
}

/// The duties that put the voltage (`v_d`, `v_q`) on the motor at the electrical angle `theta`, rad, from `supply`, V.
///
/// The amplitude must be within [`LINEAR_RANGE`] of the supply; beyond it duties clip and the voltage is distorted.
pub fn duties(v_d: f32, v_q: f32, theta: f32, supply: f32, order: PhaseOrder) -> [Duty; 3] {
    const HALF_SQRT_3: f32 = 0.866_025_4;
    let (sin, cos) = math::sin_cos(theta);
    let v_alpha = v_d * cos - v_q * sin;
    let v_beta = v_d * sin + v_q * cos;
    let a = v_alpha;
    let b = -0.5 * v_alpha + HALF_SQRT_3 * v_beta;
    let c = -0.5 * v_alpha - HALF_SQRT_3 * v_beta;
    let common = -0.5 * (a.max(b).max(c) + a.min(b).min(c));
    let per_volt = 1.0 / supply;
    let duty = |v: f32| Duty::new(0.5 + (v + common) * per_volt);
    match order {
        PhaseOrder::Abc => [duty(a), duty(b), duty(c)],
        PhaseOrder::Acb => [duty(a), duty(c), duty(b)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Voltage in stator axes that the duties put on a star.
    fn clarke(d: [Duty; 3], supply: f32) -> (f32, f32) {
        let [a, b, c] = d.map(|d| d.share() * supply);
        ((2.0 * a - b - c) / 3.0, (b - c) / 3.0_f32 * 1.732_050_8)
    }

    #[test]
    fn the_motor_sees_the_voltage_asked_for() {
        let supply = 12.0;
        let amplitude = 0.9999 * LINEAR_RANGE * supply;
        for k in -200..200 {
            let theta = 0.1 * k as f32;
            let lead = 0.37 * k as f32;
            let (q, d) = math::sin_cos(lead);
            let (v_alpha, v_beta) = clarke(
                duties(amplitude * d, amplitude * q, theta, supply, PhaseOrder::Abc),
                supply,
            );
            let (sin, cos) = math::sin_cos(theta + lead);
            assert!((v_alpha - amplitude * cos).abs() < 5e-5, "{theta} {lead}");
            assert!((v_beta - amplitude * sin).abs() < 5e-5, "{theta} {lead}");
        }
    }

    #[test]
    fn duties_stay_centred() {
        let d = duties(0.0, 3.0, 0.7, 12.0, PhaseOrder::Abc).map(Duty::share);
        let (max, min) = (d[0].max(d[1]).max(d[2]), d[0].min(d[1]).min(d[2]));
        assert!((max + min - 1.0).abs() < 1e-6);
        assert_eq!(duties(0.0, 0.0, 0.7, 12.0, PhaseOrder::Abc), [Duty::HALF; 3]);
    }

    #[test]
    fn order_exchanges_two_phases() {
        let [a, b, c] = duties(0.3, 1.0, 2.0, 12.0, PhaseOrder::Abc);
        assert_eq!(duties(0.3, 1.0, 2.0, 12.0, PhaseOrder::Acb), [a, c, b]);
    }
}
