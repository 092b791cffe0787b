//! The layout of the payloads: the same for every process, and part of the schema.
//!
//! [`Pod`] is derived for each payload, so the compiler refuses padding and fields with invalid bit
//! patterns; [`ZeroCopySend`] gives the type name that other processes compare.

use std::fmt::Debug;

use bytemuck::Pod;
pub(crate) use iceoryx2_bb_derive_macros::ZeroCopySend;
pub(crate) use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

use crate::{
    AnswerHeader, AnswerRow, Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast,
    ForecastHeader, PlanState, PlanStateHeader, QueriesHeader, QueryHeader, QueryRecord, Sample,
    SampleHeader, StateHeader, TakenFrame, TickHeader,
};

/// A type that may lie in shared memory: every bit pattern is valid, it has no padding, and its
/// layout is the same in every process. Implemented for every payload and header of this crate, and
/// for bytes.
pub trait Payload: Pod + ZeroCopySend + Debug + Default {}

impl<T: Pod + ZeroCopySend + Debug + Default> Payload for T {}

/// Fixes the size and alignment of a payload.
macro_rules! layout {
    ($type:ty, $bytes:literal) => {
        const _: () = assert!(size_of::<$type>() == $bytes);
        const _: () = assert!(align_of::<$type>() == 8);
    };
}

layout!(Sample, 64);
layout!(SampleHeader, 64);
layout!(Forecast, 72);
layout!(ForecastHeader, 320);
layout!(Diagnostic, 176);
layout!(DiagnosticHeader, 280);
layout!(Budget, 128);
layout!(BudgetHeader, 40);
layout!(PlanState, 192);
layout!(PlanStateHeader, 200);
layout!(StateHeader, 64);
layout!(TakenFrame, 40);
layout!(TickHeader, 48);
layout!(QueryHeader, 112);
layout!(AnswerHeader, 112);
layout!(AnswerRow, 64);
layout!(QueriesHeader, 184);
layout!(QueryRecord, 256);
