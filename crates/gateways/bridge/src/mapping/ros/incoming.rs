//! Decodes a robot's ROS 2 messages. The bytes are untrusted: a message that does not fit its type
//! is counted and changes nothing.

use joulebus_plausibility::{Field, Mapped, Said, SupplyStatus, whole};
use joulebus_ros_messages::{BatteryState, Message, RosError, RosType, Twist};
use serde::Deserialize;

use crate::mapping::account::{Account, Reason};
use crate::mapping::observation::{Observation, PowerOf};
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::Unit;

/// Maximum size of a message with its encapsulation header, bytes. An odometry has 720 and a name.
pub(crate) const MAX_BYTES: usize = 65_536;
/// Size of the header with which Cyclone DDS begins a request, bytes.
const HEADER_BYTES: usize = 16;

/// `power_supply_status` of `sensor_msgs/BatteryState`, where the bridge writes it.
pub(crate) const CHARGING: u8 = 1;
pub(crate) const DISCHARGING: u8 = 2;

/// A pattern of topics, one for each robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RosRoute {
    pub(crate) name: String,
    pub(crate) topic: Template,
    pub(crate) pattern: Pattern,
    pub(crate) kind: RosType,
    pub(crate) battery: BatteryFields,
    /// What a [`RosType::Bool`] says.
    pub(crate) says: Option<Says>,
}

/// What a truth value says of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Says {
    /// It is switched off, until its next message.
    Off,
    /// Its battery was exchanged.
    Swapped,
}

/// Convention by which a publisher fills in `sensor_msgs/BatteryState`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BatteryFields {
    /// The current is positive while discharging, contrary to the message's definition.
    pub(crate) discharge_is_positive: bool,
    pub(crate) percentage: Unit,
    /// The flow whose power is voltage times current. `None`: not a power.
    pub(crate) power_of: Option<PowerOf>,
    /// The number of the pack, if the robot has several.
    pub(crate) pack: Option<usize>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Received {
    pub(crate) length: usize,
    /// Its bytes with the encapsulation header. If there are more than [`MAX_BYTES`], only the
    /// first, by which a request that is too long is answered.
    pub(crate) bytes: Vec<u8>,
}

impl Received {
    /// Creates a message from the encapsulation's code and the body.
    pub(crate) fn new(encapsulation: [u8; 2], body: &[u8]) -> Self {
        let length = 4 + body.len();
        let kept = if length <= MAX_BYTES { body } else { &body[..HEADER_BYTES] };
        Self { length, bytes: [&[encapsulation[0], encapsulation[1], 0, 0], kept].concat() }
    }

    /// Takes the header off with which Cyclone DDS begins a request, and returns it in little
    /// endian: the client's id and the request's number.
    pub(crate) fn split_header(&mut self) -> Option<[u8; HEADER_BYTES]> {
        let mut header: [u8; HEADER_BYTES] = self.bytes.get(4..20)?.try_into().ok()?;
        if self.bytes[1] == 0 {
            header[..8].reverse();
            header[8..].reverse();
        }
        self.bytes.drain(4..20);
        Some(header)
    }
}

impl RosRoute {
    /// True if its messages are of a battery.
    pub(crate) const fn is_battery(&self) -> bool {
        matches!(self.kind, RosType::BatteryState | RosType::BatteryStateArray)
    }

    /// The observation in a message of `robot`, and the time in its header, ns, if it has one.
    /// `None` if there is no observation, which is counted.
    pub(crate) fn read(
        &self,
        robot: &str,
        received: &Received,
        account: &mut Account,
    ) -> Option<(Observation, Option<u64>)> {
        let mut count = |reason, name: &str| account.count(&self.name, reason, name);
        if received.length > MAX_BYTES {
            count(Reason::TooLong, robot);
            return None;
        }
        let message = match self.kind.decode(&received.bytes) {
            Ok(message) => message,
            Err(error) => {
                let is_encoding = matches!(error, RosError::Encapsulation { .. });
                let reason = if is_encoding { Reason::WrongEncoding } else { Reason::NotCdr };
                count(reason, robot);
                return None;
            }
        };
        let mut refused = |reason, field: &str| count(reason, &format!("{field} of {robot}"));
        let (seen, header) = match &message {
            Message::BatteryState(state) => {
                (self.battery.read(state, &mut refused), Some(&state.header))
            }
            Message::BatteryStateArray(array) => {
                let packs = array.packs().map(|state| self.battery.map(&state, &mut refused));
                let packs: Vec<Mapped> = packs.collect();
                let first = array.battery_states.first().map(|pack| &pack.header);
                // Packs of one size. An array without any says nothing.
                let sum = whole(&vec![1.0; packs.len()], &packs);
                let seen = first.map(|_| Observation::of(&sum));
                (seen.unwrap_or_default(), first)
            }
            Message::Twist(twist) => (motion(twist, &mut refused), None),
            Message::TwistStamped(stamped) => {
                (motion(&stamped.twist, &mut refused), Some(&stamped.header))
            }
            Message::Odometry(odometry) => {
                (motion(&odometry.twist.twist, &mut refused), Some(&odometry.header))
            }
            Message::Bool(said) => (Observation::saying(self.says, said.data), None),
        };
        if self.is_battery() && self.battery.power_of.is_some() {
            let power_w = seen.pack.map_or(f64::NAN, |(_, mapped)| mapped.seen.power_w);
            let has_power = seen.power.is_some() || !power_w.is_nan();
            account.came(&self.name, robot, &[("power", has_power)]);
        }
        let is_absent = seen.removed == Some(true);
        // A robot that is not off need not say so.
        if seen.is_empty() && self.kind != RosType::Bool || is_absent {
            account.count(&self.name, Reason::Nothing, robot);
        }
        if seen.is_empty() {
            return None;
        }
        Some((seen, header.and_then(|header| header.stamp.unix_ns())))
    }
}

impl Observation {
    fn saying(says: Option<Says>, is_true: bool) -> Self {
        let is = |which| (says == Some(which)).then_some(is_true);
        Self { off: is(Says::Off), swapped: is(Says::Swapped), ..Self::default() }
    }
}

impl BatteryFields {
    /// Reads a battery state. NaN means "not measured", by the message's definition.
    fn map(&self, state: &BatteryState, refused: &mut impl FnMut(Reason, &str)) -> Mapped {
        let sign = if self.discharge_is_positive { 1.0 } else { -1.0 };
        let status = SupplyStatus::new(state.power_supply_status);
        let charging = status.and_then(SupplyStatus::charging);
        let said = Said {
            soc_unit: self.percentage.size,
            written_a: state.current.into(),
            power_of: self.power_of.unwrap_or_default(),
            product_of: self.power_of,
            present: Some(state.present),
            charging,
            full: charging.map(|_| status == Some(SupplyStatus::Full)),
            ..Said::default()
        };
        let said = said
            .with(Field::Voltage, state.voltage.into())
            .with(Field::Current, sign * f64::from(state.current))
            .with(Field::Soc, state.percentage.into());
        if state.present && state.percentage.is_nan() {
            refused(Reason::Unknown, "percentage");
        }
        if state.present && status.is_none() {
            refused(Reason::OutOfRange, "power_supply_status");
        }
        said.map(|field, why| {
            let name = match field {
                Field::Voltage => "voltage",
                Field::Current => "current",
                _ => "percentage",
            };
            refused(why.into(), name);
        })
    }

    fn read(&self, state: &BatteryState, refused: &mut impl FnMut(Reason, &str)) -> Observation {
        let mapped = self.map(state, refused);
        if let Some(pack) = self.pack {
            if mapped.seen.voltage_v.is_nan() {
                refused(Reason::Unknown, "pack");
            }
            // One pack that is taken out is no exchange of the battery.
            return Observation { pack: Some((pack, mapped)), ..Observation::default() };
        }
        // Many drivers leave it false, and a battery that is not there has no voltage.
        let has_voltage = state.voltage > 0.0;
        let removed = Some(!state.present && !has_voltage);
        Observation { removed, ..Observation::of(&mapped) }
    }
}

/// Forward and angular velocity. With a velocity across, the speed counts.
fn motion(twist: &Twist, refused: &mut impl FnMut(Reason, &str)) -> Observation {
    // A velocity that is NaN is no number, and not one that is left out.
    let number = |value: f64| if value.is_nan() { f64::INFINITY } else { value };
    let said = Said::default()
        .with(Field::V, number(twist.linear.x))
        .with(Field::Vy, number(twist.linear.y))
        .with(Field::Omega, number(twist.angular.z));
    let mapped = said.map(|field, why| {
        let name = match field {
            Field::V => "linear.x",
            Field::Vy => "linear.y",
            _ => "angular.z",
        };
        refused(why.into(), name);
    });
    Observation::of(&mapped)
}

#[cfg(test)]
mod tests {
    use joulebus_ros_messages::{
        BatteryStateArray, Header, SpotBattery, Time, TwistStamped, Vector3, encode,
    };
    use proptest::prelude::*;
    use serde::Serialize;

    use super::*;
    use crate::mapping::units::Quantity;

    fn route(kind: RosType) -> RosRoute {
        RosRoute {
            name: "/{robot}/x".to_owned(),
            topic: Template::parse("/{robot}/x", "lab", true).unwrap(),
            pattern: Pattern::parse("/{robot}/x").unwrap(),
            kind,
            battery: BatteryFields {
                discharge_is_positive: false,
                percentage: Quantity::Share.si(),
                power_of: Some(PowerOf::Battery),
                pack: None,
            },
            says: None,
        }
    }

    fn header() -> Header {
        Header { stamp: Time::default(), frame_id: "base".to_owned() }
    }

    fn battery() -> BatteryState {
        BatteryState {
            header: header(),
            voltage: 24.0,
            temperature: f32::NAN,
            current: -2.0,
            charge: f32::NAN,
            capacity: f32::NAN,
            design_capacity: f32::NAN,
            percentage: 0.5,
            power_supply_status: DISCHARGING,
            power_supply_health: 0,
            power_supply_technology: 0,
            present: true,
            cell_voltage: vec![4.0, 4.1],
            cell_temperature: Vec::new(),
            location: "slot".to_owned(),
            serial_number: "7".to_owned(),
        }
    }

    fn twist(x: f64, y: f64, z: f64) -> Twist {
        let vector = |x, y, z| Vector3 { x, y, z };
        Twist { linear: vector(x, y, 0.0), angular: vector(0.0, 0.0, z) }
    }

    fn body(message: &impl Serialize) -> Vec<u8> {
        encode(message).unwrap()
    }

    fn read(
        route: &RosRoute,
        received: &Received,
    ) -> (Option<Observation>, Vec<(&'static str, String)>) {
        let mut account = Account::default();
        let seen = route.read("r1", received, &mut account).map(|(seen, _)| seen);
        let refused =
            account.records().into_iter().map(|record| (record.reason, record.names.join(",")));
        (seen, refused.collect())
    }

    fn read_battery(
        route: &RosRoute,
        state: &BatteryState,
    ) -> (Option<Observation>, Vec<(&'static str, String)>) {
        read(route, &Received::new([0, 1], &body(state)))
    }

    #[test]
    fn a_discharging_battery_draws_power() {
        let (seen, refused) = read_battery(&route(RosType::BatteryState), &battery());
        let seen = seen.unwrap();
        assert_eq!(refused, []);
        assert_eq!((seen.voltage_v, seen.current_a, seen.soc), (Some(24.0), Some(2.0), Some(0.5)));
        let power = seen.power.unwrap();
        assert_eq!((power.power_w, power.of), (48.0, PowerOf::Battery));
        assert_eq!((seen.charging, seen.full), (Some(false), Some(false)));
    }

    #[test]
    fn publishers_with_another_sign_or_unit_are_mapped() {
        let mut other = route(RosType::BatteryState);
        other.battery = BatteryFields {
            discharge_is_positive: true,
            percentage: Quantity::Share.unit("%").unwrap(),
            power_of: Some(PowerOf::Load),
            pack: None,
        };
        let state = BatteryState { current: 2.0, percentage: 50.0, ..battery() };
        let seen = read_battery(&other, &state).0.unwrap();
        let power = seen.power.unwrap();
        assert_eq!((power.power_w, power.of), (48.0, PowerOf::Load));
        assert_eq!((seen.current_a, seen.soc), (Some(2.0), Some(0.5)));
        other.battery.power_of = None;
        assert_eq!(read_battery(&other, &state).0.unwrap().power, None);
    }

    #[test]
    fn the_status_states_whether_a_robot_charges() {
        for (status, charging, full) in [
            (0, None, None),
            (1, Some(true), Some(false)),
            (2, Some(false), Some(false)),
            (3, Some(false), Some(false)),
            (4, Some(true), Some(true)),
        ] {
            let state = BatteryState { power_supply_status: status, current: 3.0, ..battery() };
            let seen = read_battery(&route(RosType::BatteryState), &state).0.unwrap();
            assert_eq!((seen.charging, seen.full), (charging, full), "{status}");
            assert_eq!(seen.power.unwrap().power_w, -72.0);
        }
    }

    #[test]
    fn nan_is_unknown_and_what_is_out_of_range_is_named() {
        let route = route(RosType::BatteryState);
        let unknown = BatteryState { current: f32::NAN, percentage: f32::NAN, ..battery() };
        let (seen, refused) = read_battery(&route, &unknown);
        let seen = seen.unwrap();
        assert_eq!((seen.power, seen.current_a, seen.soc), (None, None, None));
        let expected = [("unknown", "percentage of r1".to_owned())];
        assert_eq!((seen.voltage_v, refused), (Some(24.0), expected.to_vec()));
        // In either unit.
        for percentage in [Quantity::Share.si(), Quantity::Share.unit("%").unwrap()] {
            let mut route = route.clone();
            route.battery.percentage = percentage;
            let unknown = BatteryState { percentage: -1.0, ..battery() };
            let (seen, refused) = read_battery(&route, &unknown);
            let seen = seen.unwrap();
            assert_eq!((seen.soc, seen.current_a, refused), (None, Some(2.0), expected.to_vec()));
        }
        let wrong = BatteryState {
            voltage: f32::INFINITY,
            percentage: 50.0,
            power_supply_status: 9,
            ..battery()
        };
        let (seen, refused) = read_battery(&route, &wrong);
        let seen = seen.unwrap();
        // A percentage is left out of samples with all others of its robot.
        assert_eq!((seen.voltage_v, seen.power, seen.soc), (None, None, Some(50.0)));
        assert_eq!(seen.current_a, Some(2.0), "the others count");
        assert_eq!(
            refused,
            [
                ("not_finite", "voltage of r1".to_owned()),
                ("out_of_range", "percentage of r1,power_supply_status of r1".to_owned())
            ]
        );
        let unsaid = BatteryState { present: false, ..battery() };
        assert_eq!(read_battery(&route, &unsaid), read_battery(&route, &battery()));
        let absent = BatteryState { voltage: 0.0, ..unsaid };
        let (seen, refused) = read_battery(&route, &absent);
        let removed = Observation { removed: Some(true), ..Observation::default() };
        assert_eq!((seen, refused[0].0), (Some(removed), "nothing_mapped"));
    }

    #[test]
    fn velocities_come_from_commands_and_odometry() {
        for (x, y, v) in [(0.3, 0.0, 0.3), (-0.3, 0.0, -0.3), (0.3, 0.4, 0.5)] {
            let stamped = TwistStamped { header: header(), twist: twist(x, y, -0.2) };
            for (kind, bytes) in [
                (RosType::Twist, body(&twist(x, y, -0.2))),
                (RosType::TwistStamped, body(&stamped)),
            ] {
                let seen = read(&route(kind), &Received::new([0, 1], &bytes)).0.unwrap();
                assert_eq!((seen.v_mps, seen.omega_radps), (Some(v), Some(-0.2)));
            }
        }
        let bytes = body(&twist(f64::NAN, 0.0, 1e300));
        let (seen, refused) = read(&route(RosType::Twist), &Received::new([0, 1], &bytes));
        assert_eq!(seen, None);
        assert_eq!(
            refused,
            [
                ("nothing_mapped", "r1".to_owned()),
                ("not_finite", "angular.z of r1,linear.x of r1".to_owned())
            ]
        );
    }

    #[test]
    fn the_packs_of_an_array_are_summed() {
        let pack = |volt: f64, ampere: f64, percent: f64, status: u8| SpotBattery {
            header: header(),
            identifier: "pack".to_owned(),
            charge_percentage: percent,
            estimated_runtime: Time::default(),
            current: ampere,
            voltage: volt,
            temperatures: vec![30.0],
            status,
        };
        let mut array = route(RosType::BatteryStateArray);
        array.battery.power_of = Some(PowerOf::Load);
        let read = |packs: &[SpotBattery]| {
            let message = BatteryStateArray { battery_states: packs.to_vec() };
            read(&array, &Received::new([0, 1], &body(&message)))
        };
        let (one, other) = (pack(50.0, -2.0, 80.0, 3), pack(54.0, -0.5, 40.0, 3));
        let seen = read(&[one.clone(), other.clone()]).0.unwrap();
        assert_eq!((seen.power.unwrap().power_w, seen.voltage_v), (127.0, Some(52.0)));
        assert!((seen.soc.unwrap() - 0.6).abs() < 1e-6 && seen.charging == Some(false));
        assert_eq!(read(std::slice::from_ref(&one)).0.unwrap().power.unwrap().power_w, 100.0);
        // A slot without a battery leaves nothing known of the power.
        let missing = read(&[one, pack(0.0, 0.0, 0.0, 1)]).0;
        assert_eq!(missing.map(|seen| (seen.power, seen.soc)), Some((None, None)));
        assert_eq!(read(&[]), (None, vec![("nothing_mapped", "r1".to_owned())]));
    }

    #[test]
    fn a_truth_value_says_that_a_robot_is_off_or_has_another_battery() {
        for (says, is_true, expected) in [
            (Says::Off, true, (Some(true), None)),
            (Says::Swapped, true, (None, Some(true))),
            (Says::Swapped, false, (None, Some(false))),
        ] {
            let route = RosRoute { says: Some(says), ..route(RosType::Bool) };
            let message = Received::new([0, 1], &[u8::from(is_true)]);
            let seen = read(&route, &message).0.unwrap();
            assert_eq!((seen.off, seen.swapped), expected, "{says:?}");
        }
        let on = RosRoute { says: Some(Says::Off), ..route(RosType::Bool) };
        assert_eq!(read(&on, &Received::new([0, 1], &[0])), (None, Vec::new()));
        for bytes in [&[][..], &[7], &[1, 0, 0, 0, 0]] {
            let (seen, refused) = read(&on, &Received::new([0, 1], bytes));
            assert_eq!((seen, refused[0].0), (None, "not_cdr"), "{bytes:?}");
        }
    }

    #[test]
    fn either_order_of_bytes_is_read() {
        let bytes: Vec<u8> = [0.3_f64, 0.0, 0.0, 0.0, 0.0, -0.2]
            .iter()
            .flat_map(|number| number.to_be_bytes())
            .collect();
        let seen = read(&route(RosType::Twist), &Received::new([0, 0], &bytes)).0;
        let seen = seen.unwrap();
        assert_eq!((seen.v_mps, seen.omega_radps), (Some(0.3), Some(-0.2)));
    }

    #[test]
    fn bytes_that_do_not_fit_are_counted_and_change_nothing() {
        let battery = body(&battery());
        let mut huge = battery.clone();
        // The length of `frame_id`.
        huge[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        let mut cells = battery.clone();
        let at = cells.windows(4).position(|four| four == 4.0_f32.to_le_bytes());
        let at = at.unwrap() - 4;
        cells[at..at + 4].copy_from_slice(&0x7fff_ffff_u32.to_le_bytes());
        let longer: Vec<u8> = battery.iter().copied().chain([0; 40]).collect();
        for (encapsulation, bytes, reason) in [
            ([0, 1], &battery[..battery.len() - 5], "not_cdr"),
            ([0, 1], &battery[..0], "not_cdr"),
            ([0, 1], &huge, "not_cdr"),
            ([0, 1], &cells, "not_cdr"),
            ([0, 1], &longer, "not_cdr"),
            ([0, 0], &battery, "not_cdr"),
            ([0, 3], &battery, "wrong_encoding"),
            ([0, 7], &battery, "wrong_encoding"),
            ([0xff, 0xff], &battery, "wrong_encoding"),
            ([0, 1], &vec![0; MAX_BYTES], "too_long"),
        ] {
            let received = Received::new(encapsulation, bytes);
            assert!(received.bytes.len() <= MAX_BYTES);
            let (seen, refused) = read(&route(RosType::BatteryState), &received);
            assert_eq!(seen, None, "{encapsulation:?}");
            assert_eq!(refused, [(reason, "r1".to_owned())], "{encapsulation:?}");
        }
        let nothing = Received { length: 0, bytes: Vec::new() };
        assert_eq!(read(&route(RosType::Twist), &nothing).1[0].0, "wrong_encoding");
    }

    proptest! {
        #[test]
        fn no_bytes_panic_or_give_a_number_that_is_not_finite(
            bytes in prop::collection::vec(any::<u8>(), 0..900),
            at in 0usize..400,
            kind in 0usize..4,
        ) {
            let kinds = [RosType::BatteryState, RosType::Twist, RosType::TwistStamped, RosType::Odometry];
            let mut near = body(&battery());
            let at = at.min(near.len());
            near.splice(at..(at + 8).min(near.len()), bytes.iter().copied().take(8));
            for bytes in [bytes.as_slice(), near.as_slice()] {
                let (seen, refused) = read(&route(kinds[kind]), &Received::new([0, 1], bytes));
                prop_assert!(seen.is_some() || !refused.is_empty());
                if let Some(seen) = seen {
                    let power_w = seen.power.map(|power| power.power_w);
                    for number in [power_w, seen.voltage_v, seen.current_a, seen.soc, seen.v_mps, seen.omega_radps] {
                        prop_assert!(number.is_none_or(f32::is_finite));
                    }
                }
            }
        }
    }
}
