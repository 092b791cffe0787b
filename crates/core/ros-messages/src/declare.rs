//! Declares types of messages once: struct, and definition.

/// A type of a field, and its name in ROS 2.
pub(crate) trait Field {
    fn name() -> String;
}

/// A type with a definition.
pub(crate) trait Defined {
    /// The part of a file that defines it: `package/msg/Name`, and `_Request` or `_Response` of a
    /// service.
    const FILE: &'static str;

    /// Its fields, `type name` each.
    fn fields() -> Vec<String>;
}

/// The name of a type without its package.
pub(crate) fn last_part(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// Declares types with their fields, as their definitions have them. `as` gives a field's type the
/// name that it has there, if that is not the name of its Rust type.
macro_rules! messages {
    ($($(#[$about:meta])* pub struct $name:ident: $file:literal {
        $($(#[$field_about:meta])* pub $field:ident: $type:ty $(as $other:literal)?,)*
    })*) => {$(
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $name {
            $($(#[$field_about])* pub $field: $type,)*
        }

        impl $crate::declare::Defined for $name {
            const FILE: &'static str = $file;

            fn fields() -> Vec<String> {
                vec![$(format!(
                    "{} {}",
                    $crate::declare::messages!(@name $type $(, $other)?),
                    stringify!($field)
                ),)*]
            }
        }

        impl $crate::declare::Field for $name {
            fn name() -> String {
                $crate::declare::last_part($file).to_owned()
            }
        }
    )*};
    (@name $type:ty) => { <$type as $crate::declare::Field>::name() };
    (@name $type:ty, $other:literal) => { $other };
}

pub(crate) use messages;

macro_rules! names {
    ($($type:ty: $name:literal,)*) => {
        $(impl Field for $type {
            fn name() -> String {
                $name.to_owned()
            }
        })*
    };
}

names! {
    bool: "bool",
    u8: "uint8",
    u32: "uint32",
    u64: "uint64",
    i32: "int32",
    f32: "float32",
    f64: "float64",
    String: "string",
}

impl<T: Field> Field for Vec<T> {
    fn name() -> String {
        format!("{}[]", T::name())
    }
}

impl<T: Field, const LENGTH: usize> Field for [T; LENGTH] {
    fn name() -> String {
        format!("{}[{LENGTH}]", T::name())
    }
}
