//! Points on the command line.

use std::str::FromStr;

use joulebus_plan::Point;

/// A point: `X,Y` in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointArgument(pub(super) Point);

/// The point to return to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ReturnTo {
    Dock,
    At(PointArgument),
}

impl FromStr for PointArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
        let point = text.split_once(',').and_then(|(x, y)| {
            let (x_m, y_m) = (number(x)?, number(y)?);
            Some(Self(Point::new(x_m, y_m)))
        });
        point.ok_or_else(|| format!("{text:?}: expected two numbers in m, such as 1.5,-0.2"))
    }
}

impl FromStr for ReturnTo {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "dock" {
            return Ok(Self::Dock);
        }
        let point = text.parse().map(Self::At);
        point.map_err(|error| format!("{error}, or dock"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_two_finite_numbers() {
        assert_eq!("1.5,-0.2".parse(), Ok(PointArgument(Point::new(1.5, -0.2))));
        assert_eq!(" 3 , 4 ".parse(), Ok(PointArgument(Point::new(3.0, 4.0))));
        assert_eq!("dock".parse(), Ok(ReturnTo::Dock));
        for text in ["", "1", "1,", ",1", "1,2,3", "1;2", "nan,1", "1,inf", "home"] {
            assert!(text.parse::<PointArgument>().is_err(), "{text:?}");
            let error = text.parse::<ReturnTo>().expect_err(text);
            assert!(error.contains("dock"), "{error}");
        }
    }
}
