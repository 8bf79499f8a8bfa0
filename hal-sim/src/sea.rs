//! Irregular motion: a sum of sines whose spectrum is that of a sea.
//!
//! ```text
//! S(ω) ∝ ω⁻⁵ exp(−1.25 (ω_p/ω)⁴) γ^exp(−(ω/ω_p − 1)²/2s²),   s = 0.07 for ω < ω_p, 0.09 beyond
//! x(t) = Σ σ √(2/N) sin(ω_k t + φ_k),   k = 1 … N
//! ```
//!
//! γ = 1 is the spectrum of Bretschneider for a developed sea, γ = 3.3 the mean of JONSWAP for one that grows (K. Hasselmann
//! et al., *Measurements of wind-wave growth and swell decay during JONSWAP*, Dt. Hydrogr. Z. Suppl. A 8(12), 1973).
//!
//! All components have the same energy: the band is cut into N parts of the same energy, and ω_k is drawn within the k-th.
//! The frequencies have no common period, so that the motion does not repeat. Its mean square is σ² whatever the draw;
//! σ is half the significant amplitude, the mean of the highest third (M. S. Longuet-Higgins, *On the statistical
//! distribution of the heights of sea waves*, J. Mar. Res. 11, 1952).
//!
//! Not modelled: the response of a hull, which has resonances of its own; that angles and displacements of one hull are
//! correlated.

use core::f64::consts::TAU;

/// The band, in parts of the peak's frequency: below it are 2e-9 of the energy, beyond it 1.5 %.
const BAND: [f64; 2] = [0.5, 3.0];
/// Intervals by which the spectrum is integrated; a peak of width 0.07 has 70 of them.
const INTERVALS: usize = 2500;

/// One sine of the sum: of amplitude one, rad/s and rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Component {
    pub(crate) omega: f64,
    pub(crate) phase: f64,
}

/// S at ω, a constant apart; `x` is ω/ω_p.
fn spectrum(x: f64, peakedness: f64) -> f64 {
    let width = if x < 1.0 { 0.07 } else { 0.09 };
    let peak = (-0.5 * ((x - 1.0) / width).powi(2)).exp();
    x.powi(-5) * (-1.25 * x.powi(-4)).exp() * peakedness.powf(peak)
}

/// Energy up to each of the intervals' ends, in parts of the whole; [`INTERVALS`] + 1 of them.
fn energies(peakedness: f64) -> Vec<f64> {
    let density = |k: usize| spectrum(at(k as f64), peakedness);
    let mut sum = 0.0;
    let mut energies = vec![0.0];
    for k in 1..=INTERVALS {
        sum += density(k - 1) + density(k);
        energies.push(sum);
    }
    energies.iter().map(|energy| energy / sum).collect()
}

/// ω/ω_p at so many intervals from the band's lower end.
fn at(intervals: f64) -> f64 {
    let [low, high] = BAND;
    low + (high - low) * intervals / INTERVALS as f64
}

/// Components of equal energy of the sea that peaks with the period `peak_period_s`: one for each pair of `draws`, which
/// are uniform in [0, 1).
pub(crate) fn components(draws: &[[f64; 2]], peak_period_s: f64, peakedness: f64) -> Vec<Component> {
    let energies = energies(peakedness);
    let count = draws.len() as f64;
    draws
        .iter()
        .enumerate()
        .map(|(k, [within, turn])| {
            let energy = (k as f64 + within) / count;
            // The interval in which it is reached, and where in it.
            let above = energies.partition_point(|e| *e <= energy).clamp(1, INTERVALS);
            let (low, high) = (energies[above - 1], energies[above]);
            let x = at((above - 1) as f64 + (energy - low) / (high - low));
            Component {
                omega: x * TAU / peak_period_s,
                phase: turn * TAU,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn draws(count: usize) -> Vec<[f64; 2]> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        (0..count).map(|_| rng.random()).collect()
    }

    /// Mean of ω² over the components, in parts of ω_p².
    fn second_moment(peakedness: f64) -> f64 {
        let (count, period) = (400, 8.0);
        let components = components(&draws(count), period, peakedness);
        components.iter().map(|c| (c.omega * period / TAU).powi(2)).sum::<f64>() / count as f64
    }

    #[test]
    fn moments_are_those_of_the_spectrum() {
        // ∫ω² S dω / ∫S dω over the band, by the midpoint rule of 200 000 intervals in an independent program.
        for (peakedness, expected) in [(1.0, 1.7318), (3.3, 1.4884)] {
            let found = second_moment(peakedness);
            assert!((found / expected - 1.0).abs() < 0.003, "{peakedness}: {found}");
        }
    }

    #[test]
    fn energy_is_where_the_spectrum_has_it() {
        let (count, period, peakedness) = (2000, 5.0, 3.3);
        let components = components(&draws(count), period, peakedness);
        let bins = 25;
        let mut counts = vec![0.0; bins];
        for component in &components {
            let x = component.omega * period / TAU;
            assert!((BAND[0]..=BAND[1]).contains(&x));
            counts[((x - BAND[0]) / (BAND[1] - BAND[0]) * bins as f64) as usize] += 1.0;
        }
        // Most energy in the bin with the peak, and everywhere what the spectrum's integral says, up to the two
        // components at the bin's ends.
        let energies = energies(peakedness);
        for (bin, found) in counts.iter().enumerate() {
            let per = INTERVALS / bins;
            let expected = count as f64 * (energies[(bin + 1) * per] - energies[bin * per]);
            assert!((found - expected).abs() <= 2.0, "{bin}: {found}, {expected}");
        }
        let most = counts.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
        assert_eq!(most, 5, "0.1 wide from 0.5 on: 1.0 to 1.1");
    }
}
