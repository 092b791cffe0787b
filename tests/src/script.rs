//! Samples with known values.

use joulebus_wire::Sample;

/// Sample `seq` of `robot` in a script: a pure function of the two numbers. Stamps are `period_ns`
/// apart and start at one hour; the worker compares them only with each other.
pub fn sample(robot: u32, seq: u64, period_ns: u64) -> Sample {
    let stamp_ns = 3_600_000_000_000 + seq * period_ns;
    let noise = noise(robot, seq);
    let v_mps = 0.05 + (noise & 0xff) as f32 * 0.0005;
    let omega_radps = ((noise >> 8) & 0xff) as f32 * 0.02 - 2.5;
    let power_w = 3.2 + ((noise >> 16) & 0xff) as f32 * 0.004;
    Sample::new(robot, seq, stamp_ns).command(v_mps, omega_radps).reading(power_w, stamp_ns)
}

/// `frames` frames with one sample of each of `robots`.
pub fn script(robots: &[u32], frames: u64, period_ns: u64) -> Vec<Vec<Sample>> {
    (0..frames)
        .map(|seq| robots.iter().map(|robot| sample(*robot, seq, period_ns)).collect())
        .collect()
}

/// A sample of a robot with constant power, within the limits of a GTernal up to robot 130; its other values are a function of robot and number, so
/// that [`is_whole`] can check them.
pub fn steady(robot: u32, seq: u64, stamp_ns: u64) -> Sample {
    let power_w = 3.5 + robot as f32 * 0.125;
    let noise = noise(robot, seq);
    let v_mps = (noise & 0xff) as f32 * 0.0005;
    let omega_radps = ((noise >> 8) & 0xff) as f32 * 0.01;
    let voltage_v = 3.0 + ((noise >> 16) & 0xff) as f32 * 0.01;
    let current_a = ((noise >> 24) & 0xff) as f32 * 0.01;
    Sample::new(robot, seq, stamp_ns)
        .command(v_mps, omega_radps)
        .reading(power_w, stamp_ns)
        .battery(voltage_v, current_a)
}

/// True if every byte of a sample is as [`steady`] made it.
pub fn is_whole(sample: &Sample) -> bool {
    let expected = steady(sample.robot, sample.seq, sample.stamp_ns);
    // As bits: what a sample does not state is NaN.
    bytemuck::bytes_of(sample) == bytemuck::bytes_of(&expected)
}

/// SplitMix64 of the two numbers.
const fn noise(robot: u32, seq: u64) -> u64 {
    let mut state = (seq ^ ((robot as u64) << 40)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    state = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    state = (state ^ (state >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    state ^ (state >> 31)
}
