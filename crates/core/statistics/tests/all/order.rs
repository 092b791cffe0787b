//! Quantiles of numbers that are read twice equal those of the sorted numbers, to the bit.

use std::convert::Infallible;

use joulebus_statistics::metrics::ResidualQuantiles;
use joulebus_statistics::order::residual_quantiles;
use proptest::prelude::*;

fn read_twice(residuals_w: &[f32]) -> ResidualQuantiles {
    let each = |take: &mut dyn FnMut(f32)| -> Result<(), Infallible> {
        residuals_w.iter().for_each(|value| take(*value));
        Ok(())
    };
    match residual_quantiles(each) {
        Ok(found) => found,
        Err(never) => match never {},
    }
}

fn bits(quantiles: &ResidualQuantiles) -> [u64; 7] {
    let ResidualQuantiles { min_w, q05_w, q25_w, q50_w, q75_w, q95_w, max_w } = *quantiles;
    [min_w, q05_w, q25_w, q50_w, q75_w, q95_w, max_w].map(f64::to_bits)
}

/// Residuals of a coarse sensor, many of them equal; and any finite number.
fn residual() -> impl Strategy<Value = f32> {
    let coarse = (-40i8..40).prop_map(|step| f32::from(step) * 0.25);
    let any = any::<u32>().prop_map(f32::from_bits);
    let any = any.prop_filter("finite", |value| value.is_finite());
    prop_oneof![4 => coarse, 2 => -1e3f32..1e3, 1 => any, 1 => Just(-0.0), 1 => Just(0.0)]
}

proptest! {
    #[test]
    fn quantiles_of_two_passes_are_those_of_sorted_numbers(
        residuals_w in prop::collection::vec(residual(), 0..300)
    ) {
        let sorted = ResidualQuantiles::new(residuals_w.iter().copied().map(f64::from));
        prop_assert_eq!(bits(&read_twice(&residuals_w)), bits(&sorted));
    }
}

#[test]
fn an_error_of_either_pass_is_returned() {
    for fails_at in 1..=2 {
        let mut pass = 0;
        let found = residual_quantiles(|take| {
            pass += 1;
            take(1.0);
            if pass == fails_at { Err(pass) } else { Ok(()) }
        });
        assert_eq!(found.err(), Some(fails_at));
    }
}
