//! NumPy's descriptions of payloads, made from those of `joulebus-wire`.

use std::sync::OnceLock;

use joulebus_bus::ForkSection;
use joulebus_wire::{FieldLayout, FieldType, layouts};

/// Name, type and offset of each field, and the size of the whole.
pub(crate) type Layout = (Vec<(&'static str, String, usize)>, usize);

/// The layout of a payload without structs inside. `None` for another name.
pub(crate) fn layout(name: &str) -> Option<Layout> {
    let found = layouts().into_iter().find(|layout| layout.name == name)?;
    let field = |field: &FieldLayout| {
        let code = code(field.of)?;
        let shape = field.elements.map(|count| format!("({count},)"));
        Some((field.name, shape.unwrap_or_default() + code, field.offset))
    };
    let fields = found.fields.iter().map(field).collect::<Option<_>>()?;
    Some((fields, found.size))
}

/// The layout of a forecast: asked for with every frame.
pub(crate) fn forecast() -> &'static Layout {
    static FORECAST: OnceLock<Layout> = OnceLock::new();
    FORECAST.get().unwrap_or_else(|| {
        let _section = ForkSection::enter();
        FORECAST.get_or_init(|| layout("Forecast").unwrap_or_default())
    })
}

/// The type of a field, as NumPy writes it.
const fn code(of: FieldType) -> Option<&'static str> {
    Some(match of {
        FieldType::U16 => "<u2",
        FieldType::U32 => "<u4",
        FieldType::U64 => "<u8",
        FieldType::I64 => "<i8",
        FieldType::F32 => "<f4",
        FieldType::F64 => "<f8",
        _ => return None,
    })
}
