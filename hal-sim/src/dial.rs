//! A compass card as text, for terminals.

/// A compass card with north up: ring, letters, the needle where there is a heading, hollow where that is an estimate only.
/// The part of the ring within 1σ of it is drawn bold. Angles in degrees; `2 radius + 1` lines of `4 radius + 1`
/// characters, for a character is twice as high as wide.
pub(crate) fn dial(radius: u8, heading: Option<f64>, sd: f64, valid: bool) -> Vec<String> {
    let radius = usize::from(radius);
    let mut card = vec![vec![' '; 4 * radius + 1]; 2 * radius + 1];
    // Reach 1 is the ring.
    let mut put = |angle: f64, reach: f64, sign: char| {
        let (sin, cos) = angle.to_radians().sin_cos();
        let column = 2.0 * radius as f64 * (1.0 + reach * sin);
        let row = radius as f64 * (1.0 - reach * cos);
        let line = card.get_mut(row.round() as usize);
        if let Some(place) = line.and_then(|line| line.get_mut(column.round() as usize)) {
            *place = sign;
        }
    };
    for k in 0..120 {
        let angle = f64::from(3 * k);
        let off = heading.map_or(f64::MAX, |heading| (angle - heading + 180.0).rem_euclid(360.0) - 180.0);
        put(angle, 1.0, if off.abs() <= sd { 'o' } else { '·' });
    }
    for (angle, sign) in [(0.0, 'N'), (90.0, 'E'), (180.0, 'S'), (270.0, 'W')] {
        put(angle, 1.0, sign);
    }
    if let Some(heading) = heading {
        for k in 1..10 {
            put(heading, 0.08 * f64::from(k), if valid { '•' } else { '◦' });
        }
        put(heading, 0.8, if valid { '◆' } else { '◇' });
    }
    put(0.0, 0.0, '+');
    card.into_iter().map(|line| line.into_iter().collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_needle_points_where_the_heading_is() {
        let north = dial(6, Some(0.0), 0.0, true);
        assert_eq!(north.len(), 13);
        assert!(north.iter().all(|line| line.chars().count() == 25));
        let tip = |card: &[String], sign: char| {
            let found = card.iter().enumerate().find_map(|(row, line)| {
                let column = line.chars().position(|c| c == sign)?;
                Some((row, column))
            });
            found.unwrap_or_else(|| panic!("{card:#?}"))
        };
        let (row, column) = tip(&north, '◆');
        assert!(row < 3 && column == 12, "{row} {column}");
        let (row, column) = tip(&dial(6, Some(90.0), 0.0, true), '◆');
        assert!(row == 6 && column > 20, "{row} {column}");
        let (row, column) = tip(&dial(6, Some(225.0), 5.0, false), '◇');
        assert!(row > 8 && column < 6, "{row} {column}");
        // Without a heading there is no needle to be taken for one.
        assert!(!dial(6, None, 5.0, false).concat().contains(['◆', '◇', '•', '◦', 'o']));
        for wild in [f64::MAX, -1e300, f64::NAN, f64::INFINITY] {
            assert_eq!(dial(6, Some(wild), wild, true).len(), 13);
        }
    }
}
