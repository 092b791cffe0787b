//! Cards of findings: the source of the help of `joulebus data check` and of
//! docs/reference/plausibility.md.

use crate::finding::{Kind, Severity};

/// What findings of a kind mean, and what to do about them.
#[derive(Debug, Clone, Copy)]
pub struct Card {
    /// The name, which `--accept` takes.
    pub name: &'static str,
    /// Its condition.
    pub means: &'static str,
    /// Things to look at. The option that mends a recording is in the finding.
    pub check: &'static str,
    /// What was found, by its level.
    pub cases: &'static [(Severity, &'static str)],
}

use Severity::{Error, Warning};

/// In the order of [`Kind`].
pub(crate) const CARDS: [Card; 11] = [
    Card {
        name: "sign",
        means: "power or current has the other sign",
        check: "the convention of the monitor, then loose or mixed wires of its shunt",
        cases: &[
            (Error, "power is negative while the robot drives or its battery discharges"),
            (Error, "power is negative in every reading of a short recording"),
            (Error, "the sign changes within the recording"),
            (Error, "at the same commands power is positive and negative, with the same size"),
            (Warning, "power is negative at rest, and nothing shows a charger"),
            (Warning, "the current has another sign than the power"),
        ],
    },
    Card {
        name: "unit",
        means: "values are in another unit or scale, or count an energy or a charge",
        check: "the unit in the driver's documents, and whether the program converts it",
        cases: &[
            (Error, "typical values that no robot has"),
            (Error, "power is a thousand times voltage times current"),
            (Error, "a column without a unit that is in SI, or can be in several units"),
            (Error, "a charge of 0 to 100"),
            (Error, "times that are not in seconds"),
            (Error, "the unit changes within the recording"),
            (Error, "a power or current that never falls: a counter of energy or charge"),
            (Error, "a charge of at most 1 % while the robot drives"),
            (Warning, "times named as seconds are more than 20 s apart"),
        ],
    },
    Card {
        name: "clock",
        means: "times go back, stand still, or are too coarse for the rate",
        check: "the clock that stamps rows, and whether a file has several recordings",
        cases: &[
            (Error, "more than a fifth of the rows are not later than those before"),
            (Warning, "the time goes back by more than 1 s, or another recording was appended"),
        ],
    },
    Card {
        name: "hold",
        means: "a command applies long after its controller fell silent",
        check: "the controller, and whether the robot is stuck",
        cases: &[(
            Warning,
            "a command stays unchanged for more than 5 s, and the robot does not move",
        )],
    },
    Card {
        name: "never-came",
        means: "a quantity that was expected has no value",
        check: "the name of its column or topic",
        cases: &[
            (Warning, "a column named by `--map` has no value"),
            (Warning, "a column that looks like a command is not read"),
        ],
    },
    Card {
        name: "range",
        means: "values are outside the limits",
        check: "the platform's limits, then the values",
        cases: &[
            (Error, "more than half of the values are outside their limits"),
            (Warning, "some values are outside their limits"),
        ],
    },
    Card {
        name: "saturation",
        means: "the monitor is at the end of its range, or its register wraps",
        check: "the monitor's range and shunt, and the width and sign of its register",
        cases: &[
            (Error, "readings wrap at a register of 12 to 24 bits"),
            (
                Error,
                "readings around 0 jump to one far value and back, as a register without a sign \
                 does below 0",
            ),
            (Warning, "readings stay at a full register of 16 bits"),
            (Warning, "readings stay at exactly their greatest value, as at no other"),
        ],
    },
    Card {
        name: "constant",
        means: "a value never changes",
        check: "the monitor and its bus, and whether its driver measures this at all",
        cases: &[
            (Error, "power is 0 in every reading"),
            (Warning, "current or voltage is 0 in every reading"),
            (Warning, "power never changes"),
            (Error, "the current never changes while the voltage does, and power is made of it"),
            (
                Warning,
                "the same, with a power of its own. Both live only of a robot that moves, or of \
                 −1 A",
            ),
        ],
    },
    Card {
        name: "sentinel",
        means: "a number stands for no reading",
        check: "what the driver writes where the monitor does not answer",
        cases: &[
            (Error, "a number far from all others comes again and again (−999, 65535)"),
            (Error, "single voltages of exactly 0"),
            (Warning, "longer stretches of 0 V"),
            (Warning, "powers or currents of exactly 0, and no other one near 0"),
        ],
    },
    Card {
        name: "mismatch",
        means: "power differs from voltage times current",
        check: "whether all three are of one circuit, and the monitor's own power register",
        cases: &[
            (
                Error,
                "power differs from voltage times current by more than 10 % in more than half of \
                 the readings",
            ),
            (Warning, "the same in more than a twentieth of the readings"),
        ],
    },
    Card {
        name: "sources",
        means: "readings of two sources come in turn",
        check: "which programs publish on the topic, or which column tells their rows apart",
        cases: &[(Error, "readings alternate between two levels, as those of two sources")],
    },
];

impl Card {
    /// All cards, in the order of [`Kind`].
    #[must_use]
    pub const fn all() -> &'static [Self] {
        &CARDS
    }
}

impl Kind {
    /// What findings of this kind mean.
    #[must_use]
    pub const fn card(self) -> &'static Card {
        &CARDS[self as usize]
    }
}
