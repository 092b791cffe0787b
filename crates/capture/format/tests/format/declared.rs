//! A channel that is declared elsewhere has its place in a capture.

use std::io::Cursor;

use joulebus_capture_format::{
    Attachments, CaptureSettings, Message, MessageKind, Reader, Times, Writer,
};
use joulebus_wire::declare::ZeroCopySend;
use joulebus_wire::{Channel, Flow, FrameRows, Refusal, Service, frame_header, rows};
use prost_reflect::{DescriptorPool, DynamicMessage};

use crate::bits::assert_described;
use crate::fields::Bits;

#[derive(Debug, Clone, Copy)]
struct Motors;

impl Channel for Motors {
    const SERVICE: Service = Service::named("motors");
    const MESSAGE: &'static str = "Motors";
    const FLOW: Flow = Flow::Planners { kept: 0, history: 0, on_demand: false };
    const ROWS: FrameRows = FrameRows::Robots;
    type Header = MotorHeader;
    type Row = MotorPair;
}

frame_header!(MotorHeader { order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; });

rows! {
    /// Header of a frame.
    pub struct MotorHeader: "joulebus.MotorHeader", 72 {
        /// Version.
        pub schema: u32,
        /// Process.
        pub pid: u32,
        /// Run.
        #[run]
        pub worker_epoch: u64,
        /// Tick.
        pub tick: u64,
        /// When.
        #[instant]
        pub sent_ns: u64,
        /// When.
        pub sent_unix_ns: u64,
        /// Hash.
        pub motor_hash: u64,
        /// The refusal.
        pub refused: [Refusal; 1],
        /// Balance.
        pub balance: i64,
    }

    /// The motors of one robot.
    pub struct MotorPair: "joulebus.MotorPair", 56 {
        /// Id.
        pub robot: u32,
        /// Code.
        pub code: u16,
        /// Flags.
        pub flags: u16,
        /// Left and right, °C.
        pub temperature_c: [f32; 2],
        /// Temperature of the controller, °C.
        pub controller_c: f32,
        /// Faults.
        pub faults: [u16; 2],
        /// Turns so far.
        pub turns: [u64; 2],
        /// Efficiency.
        pub efficiency: f64,
        /// When it was measured.
        #[instant]
        pub measured_ns: u64,
    }
}

#[test]
fn a_channel_that_is_declared_elsewhere_is_described_written_and_read() {
    let mut bits = Bits(5);
    let frame: Vec<Message> =
        (0..200).map(|_| Message::of::<Motors>(bits.row(), bits.rows(Bits::row))).collect();
    let kind = MessageKind::of::<Motors>();
    let pool = DescriptorPool::decode(kind.descriptors().as_slice()).unwrap();
    let descriptor = pool.get_message_by_name("joulebus.Motors").unwrap();
    let settings = CaptureSettings::default();
    let mut writer = Writer::new(Vec::new(), settings, &Attachments::default()).unwrap();
    let mut robots = Vec::new();
    for message in &frame {
        let mut data = Vec::new();
        message.encode(&mut data);
        let read = DynamicMessage::decode(descriptor.clone(), data.as_slice()).unwrap();
        assert_described::<Motors>(message, &read);
        writer.write("lab", Times::default(), message).unwrap();
        message.each_robot(|row| robots.push(row));
    }
    for row in &robots {
        writer.write("lab", Times::default(), row).unwrap();
    }
    let (_, _, file) = writer.finish().unwrap();
    let kinds = [kind, MessageKind::of_robot::<Motors>()];
    let mut reader = Reader::new(Cursor::new(&file)).unwrap().with_kinds(kinds);
    for message in frame.iter().chain(&robots) {
        let entry = reader.next_entry().unwrap().unwrap();
        assert_eq!((&entry.message, &*entry.fleet), (message, "lab"));
        let topic = match message.robot() {
            None => "joulebus/lab/motors".to_owned(),
            Some(robot) => format!("joulebus/lab/robot/{robot}/motor_pair"),
        };
        assert_eq!(*entry.topic, topic);
    }
    // Others do not know it.
    let mut reader = Reader::new(Cursor::new(&file)).unwrap();
    let other = reader.next_entry().unwrap().unwrap().message;
    assert!(matches!(other, Message::Other { schema, .. } if *schema == *"joulebus.Motors"));
}
