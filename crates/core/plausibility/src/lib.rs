#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod battery;
mod card;
mod clock;
mod column;
mod edit;
mod finding;
mod front;
mod hold;
mod judge;
pub mod moment;
mod observation;
mod packs;
mod quantity;
mod resolution;
mod rows;
mod saturation;
mod sentinel;
mod sign;
mod sizes;
mod unit;

pub use battery::{
    ChargerWatch, CurrentMonitor, SupplyStatus, charging_of_text, is_charge, on_charger,
};
pub use card::Card;
pub use clock::{StampState, Stamps};
pub use edit::{Edit, Origin};
pub use finding::{Finding, Kind, Severity};
pub use front::{Field, Mapped, PowerOf, SOC, Said, Unusable};
pub use hold::{COMMAND_HOLDS_S, Expired};
pub use judge::{Judge, Known, TimeUnit};
pub use observation::Observation;
pub use packs::{Packed, Packs, whole};
pub use quantity::{Quantity, UNMEASURED_A};
pub use resolution::resolution;
pub use rows::Rows;
