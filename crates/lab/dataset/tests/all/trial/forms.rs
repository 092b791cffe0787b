//! Forms of recordings that we met in public, with our own values, and what comes of them.

use joulebus_dataset::inspect::{Limits, judge};
use joulebus_dataset::trial::{ColumnMap, MappedColumn, Trial};
use joulebus_testkit::cases;
use joulebus_testkit::trials::Files;

/// Origin, kind, header, row, `--map`, and outcome of a file. The outcome is `read`, kinds of
/// findings, or words of a refusal.
const FORMS: &str = r"
    vincedani/energy-measurement, INA219 | time of day, V beside mA and mW | TimeStamp, Voltage (V), Current (mA), Power (mW) | {hms},{V},{mA},{mW} |  | read
    GVSU-GreenSE/GreenRoom, poweronly.py | no header, a counter in place of time | 0,INA219,12.1,250.00,3.0250 | {n},INA219,{V},{mA},{W} |  | refused: time
    adafruit_ina260 on a Raspberry Pi | current before voltage, mA, V and mW without units | time,current,voltage,power | {s},{mA},{V},{mW} |  | unit
    TooTallNate/ina260, battery.csv | ISO times, A and V without units, no power | Date,Voltage,Current | {iso},{V},{A} | time=Date | refused: voltage_V=Voltage,current_A=Current
    a logger of mV and A | two conventions, no units | time,voltage,current | {s},{mV},{A} |  | unit
    a logger of µA and mV | two conventions, no units | time,voltage,current | {s},{mV},{uA} |  | unit
    abrignoni/iLEAPP #1870, BatteryBDC | mV and mA, negative while discharging | TimeStamp,Voltage_mV,InstantAmperage_mA | {iso},{mV},{-mA} | voltage_mV=Voltage_mV,current_mA=InstantAmperage_mA | sign
    SBFspot/SBFspot #455 | voltage and current swapped | time,voltage_V,current_A,power_W | {s},{A},{V},{W} |  | read
    webspiderteam/Bluetooth-DMM #13 | a value beside its unit | index,type,value,unit | {n},DC,{V},V |  | refused: time
    amund7/ScanMyTesla #43 | cells in columns, no power | Time,Cell temp min,Cell min,Cell avg | {s},20,3.9,4.0 |  | refused: power
    PlotJuggler/PlotJuggler #1038 | rows with some columns, two topics | __time,/r/battery_state/voltage,/r/battery_state/current,/r/cmd_vel/linear/x | {s},{V},{A},\n{s+},,,0.2 |  | read
    PlotJuggler/PlotJuggler #1233 | ns since 1970, rows with some columns | timestamp,battery/voltage,battery/current,cmd_vel/linear/x | {ns},{V},{A},\n{ns+},,,0.2 |  | read
    turtlebot/turtlebot4_robot #15 | BatteryState echoed, negative while discharging | header.stamp.sec,header.stamp.nanosec,voltage,current,percentage | {sec},{nsec},{V},{-A},{soc} | voltage_V=voltage,current_A=current,soc_share=percentage | sign
    mavlink/mavros #1284 | a negative percentage for a charge that is not known | time,battery.voltage,battery.current,battery.percentage | {s},{V},{A},-1 |  | read
    aerostack2/aerostack2 #562 | a percentage of 0 to 100 | time,battery.voltage,battery.current,battery.percentage | {s},{V},{A},{pct} |  | unit
    ROBOTIS-GIT/turtlebot3 #326 | a current that is always 0 | time,battery.voltage,battery.current | {s},{V},0 |  | constant
    Mozilla/docornot, codecarbon.csv | parts of a computer's power, no sum | timestamp,duration,cpu_power,gpu_power,ram_power,cpu_energy | {iso},{s},{W},1,12,0.1 |  | refused: power_W=
    powercap, energy_uj of RAPL | a counter of energy | timestamp,energy_uj | {s},{n} |  | refused: power
    rbonghi/jetson_stats, jtop logger | total power in mW without a unit | time,RAM,GPU,Power TOT | {iso},0.3,12,{mW} | power_mW=Power TOT | read
    tegrastats with time | words of a logger | 10-10-2026 10:00:00 RAM 1/2MB VDD_IN 4900mW/4900mW | 10-10-2026 10:00:01 RAM 1/2MB VDD_IN 4900mW/4900mW |  | refused: time
    VESC Tool, CSV of the app | semicolons, ms of the day, input voltage and current | ms_today;input_voltage;current_motor;current_in;battery_level | {ms};{V};3.0;{A};{soc} | time_ms=ms_today,voltage_V=input_voltage,current_A=current_in | read
    Renogy Rover, renogy-klient --csv | V and A of the battery, solar power | DateTime,BatterySOC,BatteryVoltage,ChargingCurrent,SolarPanelPower | {iso},{pct},{V},{A},40 | time=DateTime,soc_percent=BatterySOC,voltage_V=BatteryVoltage,current_A=ChargingCurrent | read
    Victron VRM, benchmark of a BMV | a row of units below the header | timestamp,Voltage,Current\n,V,A | {iso},{V},{-A} | voltage_V=Voltage,current_A=Current | refused: --whole-rows
    Clearpath husky, status.csv of rosbag tools | time in ns, powers of drivers in W | Time,left_driver_voltage,battery_voltage,mcu_and_user_port_current | {ns},{V},{V},{A} | time_ns=Time,voltage_V=battery_voltage,current_A=mcu_and_user_port_current | read
    ArduPilot, BAT of a .BIN | its time in µs, volts, ampere | TimeUS,Instance,Volt,Curr,CurrTot,RemPct | {us},0,{V},{A},1,{pct} | time_us=TimeUS,voltage_V=Volt,current_A=Curr,soc_percent=RemPct | read
    a logger that starts again into its file | times from 0 again in the middle | time,power_W | {again},{W} |  | clock
";

const ROWS: u32 = 240;

/// A row of a template.
pub(super) fn row(template: &str, number: u32) -> String {
    let at = f64::from(number);
    let time_s = at * 0.1;
    let ampere = 1.0 + 0.1 * (0.7 * at).sin() + 0.05 * (2.9 * at).cos();
    let volt = 12.0 - 0.1 * ampere + 0.003 * (5.1 * at).sin();
    let (watt, soc) = (volt * ampere, 0.8 - 1e-4 * at);
    let epoch_ns = |time_s: f64| 1_767_225_600_000_000_000 + (time_s * 1e9).round() as u64;
    let (hours, rest) = (time_s.floor() as u64 / 3600, time_s % 3600.0);
    let clock = format!("{:02}:{:02}:{:09.6}", 10 + hours, rest as u64 / 60, rest % 60.0);
    let again = if number < ROWS / 2 { time_s } else { time_s - f64::from(ROWS / 2) * 0.1 };
    // Two sources in turn, and a power whose sign changes in every tenth row.
    let one = if number.is_multiple_of(2) { 1.0 } else { 0.1 };
    let sign = if number.is_multiple_of(10) { -1.0 } else { 1.0 };
    let mixed = if number == 3 { "8 W".to_owned() } else { format!("{}000 mW", number + 5) };
    let pairs = [
        ("{inst}", (number % 2).to_string()),
        ("{A/inst}", format!("{:.4}", one * ampere)),
        ("{W/inst}", format!("{:.4}", one * watt)),
        ("{0.7A}", format!("{:.4}", 0.7 * ampere)),
        ("{±W}", format!("{:.4}", sign * watt)),
        ("{MW}", format!("{:.0}", watt * 1e6)),
        ("{epoch_ms}", (1_775_556_000_000 + u64::from(number) * 100).to_string()),
        ("{down_ms}", (1_775_559_599_000 - u64::from(number) * 1_000).to_string()),
        ("{n+3}", (number + 3).to_string()),
        ("{n+5}", (number + 5).to_string()),
        ("{n+7}", (number + 7).to_string()),
        ("{n/2+1}", format!("{}", at / 2.0 + 1.0)),
        ("{24-n}", (24.0 - at).to_string()),
        ("{40+n}", (40 + number).to_string()),
        ("{59-n}", (59.0 - at).to_string()),
        ("{tens}", (number / 10).to_string()),
        ("{ones}", (number % 10).to_string()),
        ("{day}", (7 + number / 10).to_string()),
        ("{mixed}", mixed),
        ("{n}", number.to_string()),
        ("{s}", format!("{time_s:.3}")),
        ("{s+}", format!("{:.3}", time_s + 0.03)),
        ("{again}", format!("{again:.3}")),
        ("{ms}", format!("{:.0}", 36e6 + time_s * 1e3)),
        ("{us}", format!("{:.0}", 7e6 + time_s * 1e6)),
        ("{ns}", epoch_ns(time_s).to_string()),
        ("{ns+}", epoch_ns(time_s + 0.03).to_string()),
        ("{sec}", (1_767_225_600 + time_s as u64).to_string()),
        ("{nsec}", format!("{:.0}", time_s.fract() * 1e9)),
        ("{hms}", clock.clone()),
        ("{iso}", format!("2026-01-01T{clock}")),
        ("{V}", format!("{volt:.3}")),
        ("{mV}", format!("{:.0}", volt * 1e3)),
        ("{A}", format!("{ampere:.3}")),
        ("{-A}", format!("{:.3}", -ampere)),
        ("{mA}", format!("{:.1}", ampere * 1e3)),
        ("{-mA}", format!("{:.0}", -ampere * 1e3)),
        ("{uA}", format!("{:.0}", ampere * 1e6)),
        ("{W}", format!("{watt:.4}")),
        ("{mW}", format!("{:.1}", watt * 1e3)),
        ("{soc}", format!("{soc:.4}")),
        ("{pct}", format!("{:.2}", soc * 100.0)),
    ];
    pairs.iter().fold(template.to_owned(), |text, (token, value)| text.replace(token, value))
}

/// Reads a file of one row. Returns the first kinds of findings, or the expected words that a
/// refusal has.
fn outcome(files: &Files, header: &str, template: &str, columns: &str, expected: &str) -> String {
    let mut text = format!("{header}\n");
    for number in 0..ROWS {
        text += &row(template, number);
        text.push('\n');
    }
    let path = files.write("log.csv", text.as_bytes());
    let columns = columns.split(',').filter(|column| !column.is_empty());
    let columns: Vec<MappedColumn> = columns.map(|one| one.parse().unwrap()).collect();
    let trials = match Trial::read_mapped(path, &ColumnMap::from(columns)) {
        Ok(trials) => trials,
        Err(error) => {
            let printed = error.to_string();
            let part = expected.strip_prefix("refused: ").filter(|part| printed.contains(part));
            return part.map_or(format!("refused: {printed}"), |_| expected.to_owned());
        }
    };
    let found = trials.iter().flat_map(|trial| judge(trial, &Limits::default()));
    let mut kinds: Vec<&str> = found.map(|one| one.finding.kind.name()).collect();
    kinds.dedup();
    match kinds.is_empty() {
        true => "read".to_owned(),
        false => kinds.join(", "),
    }
}

#[test]
fn public_forms_are_read_or_refused_as_stated() {
    let files = Files::new();
    let mut wrong = Vec::new();
    for case in cases(FORMS) {
        let [source, what, header, template, columns, expected] = case.as_slice() else {
            panic!("{case:?}");
        };
        let found = outcome(&files, header, template, columns, expected);
        if found != *expected {
            wrong.push(format!("{source}, {what}: {found}, and not {expected}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
