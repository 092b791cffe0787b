//! Declaration of structs of shared memory, once each, by [`crate::rows!`].

use std::fmt::Debug;

use bytemuck::Pod;

use declare::ZeroCopySend;

/// Names that [`crate::rows!`] needs where it is used.
pub mod declare {
    pub use iceoryx2_bb_derive_macros::ZeroCopySend;
    pub use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

    #[doc(hidden)]
    pub use super::{Described, field};
}

/// A type that may lie in shared memory: every bit pattern is valid, it has no padding, and its
/// layout is the same in every process. Implemented for every payload and header of this crate, and
/// for bytes.
pub trait Payload: Pod + ZeroCopySend + Debug + Default + Send + Sync {}

impl<T: Pod + ZeroCopySend + Debug + Default + Send + Sync> Payload for T {}

/// A struct that `rows!` declares, with the table of its fields.
pub trait Row: Payload {
    /// Its fields in the order of memory, without padding.
    const LAYOUT: StructLayout;

    /// Calls `each` with every [`FieldRole::Instant`]. An unknown one is 0.
    fn instants(&mut self, each: impl FnMut(&mut u64)) {
        each_at(self, const { &offsets::<Self>([false, true, false]) }, each);
    }

    /// Calls `each` with every [`FieldRole::Run`]. An unknown one is 0.
    fn runs(&mut self, each: impl FnMut(&mut u64)) {
        each_at(self, const { &offsets::<Self>([false, false, true]) }, each);
    }
}

/// Bytes are rows without fields.
impl Row for u8 {
    const LAYOUT: StructLayout = element::<Self>("u8");
}

/// Words are rows without fields.
impl Row for u64 {
    const LAYOUT: StructLayout = element::<Self>("u64");
}

const fn element<T>(name: &'static str) -> StructLayout {
    StructLayout { name, doc: "", fields: &[], size: size_of::<T>(), align: align_of::<T>() }
}

/// Maximum number of instants or runs of a row.
const MAX_MOVED: usize = 16;

/// Offsets of the fields with a role, and their number.
const fn offsets<R: Row>(is_wanted: [bool; 3]) -> ([usize; MAX_MOVED], usize) {
    let fields = R::LAYOUT.fields;
    let (mut found, mut count, mut at) = ([0; MAX_MOVED], 0, 0);
    while at < fields.len() {
        if is_wanted[fields[at].role as usize] {
            found[count] = fields[at].offset;
            count += 1;
        }
        at += 1;
    }
    (found, count)
}

fn each_at<R: Row>(
    row: &mut R,
    (offsets, count): &([usize; MAX_MOVED], usize),
    mut each: impl FnMut(&mut u64),
) {
    let bytes = bytemuck::bytes_of_mut(row);
    for offset in &offsets[..*count] {
        if let Some(word) = bytes[*offset..].first_chunk_mut() {
            let mut value = u64::from_ne_bytes(*word);
            each(&mut value);
            *word = value.to_ne_bytes();
        }
    }
}

/// The meaning of a field wherever a frame is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FieldRole {
    /// A value that means the same everywhere.
    Value,
    /// An instant of the monotonic clock of the host where the frame was sent, ns.
    Instant,
    /// The run of a source or of the worker, named on every host by the instant at which it began.
    Run,
}

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FieldType {
    /// A byte. An array of them is text ([`crate::text`]).
    U8,
    /// 16 bits, unsigned.
    U16,
    /// 32 bits, unsigned.
    U32,
    /// 64 bits, unsigned.
    U64,
    /// 64 bits, signed.
    I64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
    /// Another struct of [`crate::layouts`], by its name.
    Struct(&'static str),
}

/// A field of a struct in shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldLayout {
    /// Its name.
    pub name: &'static str,
    /// Its comment, in Markdown: a line of the source is a line.
    pub doc: &'static str,
    /// Its type, or that of its elements if it is an array.
    pub of: FieldType,
    /// Number of elements. `None` if it is no array.
    pub elements: Option<usize>,
    /// Bytes from the beginning of the struct.
    pub offset: usize,
    /// Its bytes.
    pub size: usize,
    /// Its meaning wherever a frame is read.
    pub role: FieldRole,
}

/// A struct in shared memory. There is no padding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StructLayout {
    /// Its name.
    pub name: &'static str,
    /// Its comment, in Markdown: a line of the source is a line.
    pub doc: &'static str,
    /// Its fields, in the order of memory.
    pub fields: &'static [FieldLayout],
    /// Its bytes.
    pub size: usize,
    /// Its alignment, bytes.
    pub align: usize,
}

/// The type of a field of a row.
pub trait Described {
    /// This type, or that of its elements if it is an array.
    const OF: FieldType;
    /// Number of elements. `None` if it is no array.
    const ELEMENTS: Option<usize> = None;
}

macro_rules! described {
    ($($type:ty => $of:expr),* $(,)?) => { $(impl Described for $type { const OF: FieldType = $of; })* };
}

described!(
    u8 => FieldType::U8,
    u16 => FieldType::U16,
    u32 => FieldType::U32,
    u64 => FieldType::U64,
    i64 => FieldType::I64,
    f32 => FieldType::F32,
    f64 => FieldType::F64,
);

impl<T: Described, const N: usize> Described for [T; N] {
    const OF: FieldType = T::OF;
    const ELEMENTS: Option<usize> = Some(N);
}

/// A field, whose type follows from how it is reached.
#[must_use]
pub const fn field<P, T: Described>(
    name: &'static str,
    doc: &'static str,
    offset: usize,
    role: FieldRole,
    _: fn(&P) -> &T,
) -> FieldLayout {
    FieldLayout { name, doc, of: T::OF, elements: T::ELEMENTS, offset, size: size_of::<T>(), role }
}

/// Declares structs of shared memory: `Name: type name, bytes` and, where it is not 8, the
/// alignment. The file imports [`crate::declare::ZeroCopySend`], which the derive names without a
/// path, and its crate has `bytemuck` with `derive`.
///
/// iceoryx2 compares the type name between processes. [`Pod`] is derived, so the compiler refuses
/// padding and fields with invalid bit patterns. Size and alignment are part of the schema: another
/// one does not compile. [`Row::LAYOUT`] lists the fields, with their comments, for other
/// languages. `#[instant]` and `#[run]` mark the fields of these [`FieldRole`]s.
#[macro_export]
macro_rules! rows {
    ($($(#[doc = $doc:literal])* $(#[derive($derive:ident)])?
    pub struct $name:ident: $type_name:tt, $bytes:literal $(, $align:literal)? {
        $($(#[doc = $field_doc:literal])* $(#[instant $($instant:tt)?])? $(#[run $($run:tt)?])?
        pub $field:ident: $type:ty,)*
    })*) => {$(
        $(#[doc = $doc])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, $($derive,)? Default)]
        #[derive(bytemuck::Pod, bytemuck::Zeroable, ZeroCopySend)]
        #[type_name($type_name)]
        pub struct $name {
            $($(#[doc = $field_doc])* pub $field: $type,)*
        }

        const _: () = assert!(size_of::<$name>() == $bytes);
        const _: () = assert!(align_of::<$name>() == $crate::rows!(@align $($align)?));

        impl $crate::declare::Described for $name {
            const OF: $crate::FieldType = $crate::FieldType::Struct(stringify!($name));
        }

        impl $crate::Row for $name {
            const LAYOUT: $crate::StructLayout = $crate::StructLayout {
                name: stringify!($name),
                doc: concat!($($doc, "\n",)*),
                fields: &[$($crate::declare::field(
                    stringify!($field),
                    concat!($($field_doc, "\n",)*),
                    std::mem::offset_of!($name, $field),
                    $crate::rows!(@role $(Instant $($instant)?)? $(Run $($run)?)?),
                    |row: &$name| &row.$field,
                )),*],
                size: size_of::<$name>(),
                align: align_of::<$name>(),
            };
        }
    )*};
    (@role) => { $crate::FieldRole::Value };
    (@role $role:ident) => { $crate::FieldRole::$role };
    (@align) => { 8 };
    (@align $align:literal) => { $align };
}

/// Declares a module of bits of one field, with their `TABLE` of name, value and comment.
macro_rules! bits {
    ($(#[doc = $doc:literal])* pub mod $module:ident {
        $($(#[doc = $bit_doc:literal])* pub const $name:ident: $type:ty = $value:expr;)*
    }) => {
        $(#[doc = $doc])*
        pub mod $module {
            $($(#[doc = $bit_doc])* pub const $name: $type = $value;)*

            pub(crate) const TABLE: &[(&str, u64, &str)] =
                &[$((stringify!($name), $name as u64, concat!($($bit_doc, "\n",)*))),*];
        }
    };
}

pub(crate) use bits;

/// Lists the variants of an enum once: `ALL`, and after a semicolon those that are not among them.
/// Each has the name that it has here.
macro_rules! names {
    ($(#[$doc:meta])* $vis:vis $type:ident: $($variant:ident)+ $(; $($other:ident)+)?) => {
        impl $type {
            $(#[$doc])*
            $vis const ALL: [Self; [$(stringify!($variant)),+].len()] = [$(Self::$variant),+];

            /// The name, as in the documentation and in JSON.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => stringify!($variant),)+
                    $($(Self::$other => stringify!($other),)+)?
                }
            }
        }
    };
}
pub(crate) use names;
