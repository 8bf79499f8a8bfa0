//! Random numbers for tests.

/// One of variance one, near enough normal: the sum of twelve of SplitMix64.
pub(crate) fn normal(state: &mut u64) -> f32 {
    (0..12)
        .map(|_| {
            *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let x = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((x ^ (x >> 31)) >> 40) as f32 / 16_777_216.0 - 0.5
        })
        .sum()
}
