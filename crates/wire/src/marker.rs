//! The marker that lets the payloads lie in shared memory, and the proof of their layout.
#![allow(unsafe_code)]

use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

use crate::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Sample,
    SampleHeader, StateHeader, TakenFrame, TickHeader,
};

/// Marks a payload: its name, its size, and that its fields fill it without padding.
macro_rules! payload {
    ($type:ty, $name:literal, $size:literal) => {
        // SAFETY: the payload is `repr(C)`, holds only integers, floats and arrays of them (no
        // pointer, no handle), and the assertion below fixes its size, so the layout is the same
        // in every process that knows it by this name.
        unsafe impl ZeroCopySend for $type {
            unsafe fn type_name() -> &'static str {
                $name
            }
        }
        const _: () = assert!(
            size_of::<$type>() == $size,
            "the layout is part of the schema"
        );
        const _: () = assert!(align_of::<$type>() == 8, "the layout is part of the schema");
    };
}

payload!(Sample, "joulebus.Sample.v1", 56);
payload!(SampleHeader, "joulebus.SampleHeader.v1", 64);
payload!(Forecast, "joulebus.Forecast.v1", 72);
payload!(ForecastHeader, "joulebus.ForecastHeader.v1", 320);
payload!(Diagnostic, "joulebus.Diagnostic.v1", 128);
payload!(DiagnosticHeader, "joulebus.DiagnosticHeader.v1", 280);
payload!(Budget, "joulebus.Budget.v1", 112);
payload!(BudgetHeader, "joulebus.BudgetHeader.v1", 40);
payload!(StateHeader, "joulebus.StateHeader.v1", 64);
payload!(TakenFrame, "joulebus.TakenFrame.v1", 40);
payload!(TickHeader, "joulebus.TickHeader.v1", 48);
