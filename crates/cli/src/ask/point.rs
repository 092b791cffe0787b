//! Points on the command line.

use std::str::FromStr;

use joulebus_plan::Point;

/// The point to return to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ReturnTo {
    /// Where the path begins.
    Dock,
    /// `X,Y` in m.
    At(Point),
}

impl FromStr for ReturnTo {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "dock" {
            return Ok(Self::Dock);
        }
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
        let point = text.split_once(',').and_then(|(x, y)| Some((number(x)?, number(y)?)));
        let (x_m, y_m) = point.ok_or_else(|| {
            format!("{text:?}: expected two numbers in m, such as 1.5,-0.2, or dock")
        })?;
        Ok(Self::At(Point::new(x_m, y_m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_return_is_to_the_dock_or_to_two_finite_numbers() {
        assert_eq!("1.5,-0.2".parse(), Ok(ReturnTo::At(Point::new(1.5, -0.2))));
        assert_eq!(" 3 , 4 ".parse(), Ok(ReturnTo::At(Point::new(3.0, 4.0))));
        assert_eq!("dock".parse(), Ok(ReturnTo::Dock));
        for text in ["", "1", "1,", ",1", "1,2,3", "1;2", "nan,1", "1,inf", "home"] {
            let error = text.parse::<ReturnTo>().expect_err(text);
            assert!(error.contains("dock"), "{error}");
        }
    }
}
