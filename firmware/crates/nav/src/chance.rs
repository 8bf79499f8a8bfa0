//! Random numbers for tests.

use frames::{Sensor, Vec3};

/// Chance, seeded: SplitMix64.
pub(crate) struct Chance(pub(crate) u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Of twelve uniform ones, near enough to a normal one: only variances count here.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    pub(crate) fn normals(&mut self) -> Vec3<Sensor, f64> {
        Vec3::new(self.normal(), self.normal(), self.normal())
    }
}
