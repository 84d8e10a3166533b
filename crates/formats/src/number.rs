//! Decimal numbers out of bytes: the hot loop of every text format.

/// Powers of ten that `f64` holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];
/// Largest whole number below which `f64` holds every one.
const EXACT_WHOLE: u64 = 1 << 53;

/// The number at the head of `bytes` and how many bytes it takes, correctly rounded; `None` where only
/// [`parse_float`] of the whole word can tell.
///
/// A whole number below 2⁵³ times or over a power of ten up to 10²² is one rounding of two exact values (Clinger 1990,
/// *How to read floating point numbers accurately*): that covers what meshes and motion files hold.
#[inline]
pub(crate) fn float_prefix(bytes: &[u8]) -> Option<(f64, usize)> {
    let negative = bytes.first() == Some(&b'-');
    let mut at = usize::from(negative || bytes.first() == Some(&b'+'));
    let first = at;
    // Wraps after 19 digits; such words are left to the exact way below.
    let mut whole = 0u64;
    let digits = |at: &mut usize, whole: &mut u64| {
        while let Some(digit) = bytes.get(*at).map(|b| b.wrapping_sub(b'0')).filter(|&d| d < 10) {
            *whole = whole.wrapping_mul(10).wrapping_add(u64::from(digit));
            *at += 1;
        }
    };
    digits(&mut at, &mut whole);
    let mut count = at - first;
    let mut exponent = 0i32;
    if bytes.get(at) == Some(&b'.') {
        at += 1;
        let point = at;
        digits(&mut at, &mut whole);
        let decimals = at - point;
        count += decimals;
        exponent = -(decimals.min(1000) as i32);
    }
    if count == 0 || count > 19 || whole > EXACT_WHOLE {
        return None;
    }
    if matches!(bytes.get(at), Some(b'e' | b'E')) {
        let mut end = at + 1;
        let down = bytes.get(end) == Some(&b'-');
        end += usize::from(down || bytes.get(end) == Some(&b'+'));
        let start = end;
        let mut power = 0u64;
        digits(&mut end, &mut power);
        if end == start || end - start > 3 {
            return None;
        }
        exponent += if down { -(power as i32) } else { power as i32 };
        at = end;
    }
    let power = *EXACT_POWERS.get(exponent.unsigned_abs() as usize)?;
    let value = if exponent < 0 { whole as f64 / power } else { whole as f64 * power };
    Some((if negative { -value } else { value }, at))
}

/// A whole word as a number, correctly rounded; what [`str::parse`] takes.
pub(crate) fn parse_float(word: &[u8]) -> Option<f64> {
    match float_prefix(word) {
        Some((value, length)) if length == word.len() => Some(value),
        _ => std::str::from_utf8(word).ok()?.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_gets_the_bits_of_the_standard_library() {
        let edges = "0 -0 +0 1 -1 1. .5 -.5 +.5 1e5 1E+5 1e-5 0.1 0.123456789 123456.789012 9007199254740992 \
            9007199254740993 9007199254740991e22 1e22 1e23 1e-22 1e-23 123456789012345678901234567890 0.00000000000000000001 \
            1e308 1e309 1e-320 5e-324 1e400 inf -inf nan infinity NaN 18446744073709551616 1e0001 0e99999 1e00000000005 \
            00000000000000000000000001 2.2250738585072011e-308 1.7976931348623157e308 0.1e1 100000000000000000000e-20";
        let no_numbers =
            ["", "-", "+", ".", "-.", "e5", "1e", "1e+", "1e5.5", "1.2.3", "--1", "1x", "0x10", "1_0", " 1", "1 "];
        for word in edges.split_whitespace().chain(no_numbers) {
            let wanted = word.parse::<f64>().ok().map(f64::to_bits);
            assert_eq!(parse_float(word.as_bytes()).map(f64::to_bits), wanted, "{word}");
        }
        // Pseudo-random mantissas of every length, written in every way that meshes use.
        let mut state = 1u64;
        for round in 0..200_000u32 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let x = f64::from_bits(state);
            let small = (state >> 11) as f64 / (1u64 << (round % 60)) as f64;
            let word = match round % 5 {
                0 => format!("{small:.6}"),
                1 => format!("{small:.8}"),
                2 => format!("{small}"),
                3 => format!("{x:e}"),
                _ => format!("{}e{}", state >> (round % 64), (state % 700) as i32 - 350),
            };
            let wanted = word.parse::<f64>().ok().map(f64::to_bits);
            assert_eq!(parse_float(word.as_bytes()).map(f64::to_bits), wanted, "{word}");
        }
    }

    #[test]
    fn a_prefix_stops_where_the_number_stops() {
        assert_eq!(float_prefix(b"1.5 2"), Some((1.5, 3)));
        assert_eq!(float_prefix(b"-2\n"), Some((-2.0, 2)));
        assert_eq!(float_prefix(b"3e2#"), Some((300.0, 3)));
        assert_eq!(float_prefix(b"4/5"), Some((4.0, 1)));
        assert_eq!(float_prefix(b"5e"), None);
        assert_eq!(float_prefix(b""), None);
    }
}
