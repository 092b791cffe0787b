//! Cards of findings: the source of the help of `joulebus data check` and of
//! docs/reference/plausibility.md.

use crate::finding::{Kind, Severity};

/// What findings of a kind mean, and what to do about them.
#[derive(Debug, Clone)]
pub struct Card {
    /// The name, which `--accept` takes.
    pub name: &'static str,
    /// Its condition.
    pub means: &'static str,
    /// Things to look at. The option that mends a recording is in the finding.
    pub check: &'static str,
    /// What was found, by its level.
    pub cases: Vec<(Severity, &'static str)>,
}

/// Kinds in their order: name, condition, and what to look at. Below each are its cases.
const CARDS: &str = "\
sign | power or current has the other sign | the convention of the monitor, then loose or mixed wires of its shunt
  error | power is negative while the robot drives or its battery discharges
  error | power is negative in every reading of a short recording
  error | the sign changes within the recording
  error | at the same commands power is positive and negative, with the same size
  warning | power is negative at rest, and nothing shows a charger
  warning | the current has another sign than the power
unit | values are in another unit or scale, or count an energy or a charge | the unit in the driver's documents, and whether the program converts it
  error | typical values that no robot has
  error | power is a thousand times voltage times current
  error | a column without a unit that is in SI, or can be in several units
  error | a charge of 0 to 100
  error | times that are not in seconds
  error | the unit changes within the recording
  error | a power or current that never falls: a counter of energy or charge
  error | a charge of at most 1 % while the robot drives
  warning | times named as seconds are more than 20 s apart
clock | times go back, stand still, or are too coarse for the rate | the clock that stamps rows, and whether a file has several recordings
  error | more than a fifth of the rows are not later than those before
  warning | the time goes back by more than 1 s, or another recording was appended
hold | a command applies long after its controller fell silent | the controller, and whether the robot is stuck
  warning | a command stays unchanged for more than 5 s, and the robot does not move
never-came | a quantity that was expected has no value | the name of its column or topic
  warning | a column named by `--map` has no value
  warning | a column that looks like a command is not read
range | values are outside the limits | the platform's limits, then the values
  error | more than half of the values are outside their limits
  warning | some values are outside their limits
saturation | the monitor is at the end of its range, or its register wraps | the monitor's range and shunt, and the width and sign of its register
  error | readings wrap at a register of 12 to 24 bits
  error | readings around 0 jump to one far value and back, as a register without a sign does below 0
  warning | readings stay at a full register of 16 bits
  warning | readings stay at exactly their greatest value, as at no other
constant | a value never changes | the monitor and its bus, and whether its driver measures this at all
  error | power is 0 in every reading
  warning | current or voltage is 0 in every reading
  warning | power never changes
  error | the current never changes while the voltage does, and power is made of it
  warning | the same, with a power of its own. Both live only of a robot that moves, or of −1 A
sentinel | a number stands for no reading | what the driver writes where the monitor does not answer
  error | a number far from all others comes again and again (−999, 65535)
  error | single voltages of exactly 0
  warning | longer stretches of 0 V
  warning | a single power or current of twenty times all others
  warning | powers or currents of exactly 0, and no other one near 0
mismatch | power differs from voltage times current | whether all three are of one circuit, and the monitor's own power register
  error | power differs from voltage times current by more than 10 % in more than half of the readings
  warning | the same in more than a twentieth of the readings
sources | readings of two sources come in turn | which programs publish on the topic, or which column tells their rows apart
  error | readings alternate between two levels, as those of two sources";

impl Card {
    /// All cards, in the order of [`Kind`].
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut cards: Vec<Self> = Vec::new();
        for line in CARDS.lines() {
            let mut cells = line.split(" | ");
            let mut next = || cells.next().unwrap_or_default();
            match (next(), cards.last_mut()) {
                ("  error", Some(card)) => card.cases.push((Severity::Error, next())),
                ("  warning", Some(card)) => card.cases.push((Severity::Warning, next())),
                (name, _) => {
                    cards.push(Self { name, means: next(), check: next(), cases: Vec::new() });
                }
            }
        }
        cards
    }
}

impl Kind {
    /// The name.
    #[must_use]
    pub fn name(self) -> &'static str {
        let mut cards = CARDS.lines().filter(|line| !line.starts_with(' '));
        let card = cards.nth(self as usize).unwrap_or_default();
        card.split(" | ").next().unwrap_or_default()
    }

    /// What findings of this kind mean.
    #[must_use]
    pub fn card(self) -> Card {
        // A test finds one for each kind.
        Card::all().swap_remove(self as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_its_card() {
        assert_eq!(Card::all().len(), Kind::ALL.len());
        for kind in Kind::ALL {
            let own = format!("{kind:?}").to_lowercase();
            assert_eq!(kind.card().name.replace('-', ""), own);
            assert!(!kind.card().check.is_empty() && !kind.card().cases.is_empty(), "{own}");
        }
    }
}
