//! Seeds: one number in, independent streams out.

/// Derives the seed for a part of a computation: `derive(seed, &[trial, repeat])`.
///
/// Applies the SplitMix64 finaliser to each index in turn (Steele, Lea, Flood, OOPSLA 2014), so
/// that streams of neighbouring indices are visibly unrelated. Pure: the same inputs give the same
/// seed on every machine.
pub fn derive(seed: u64, path: &[u64]) -> u64 {
    path.iter().fold(mix(seed), |state, &index| {
        mix(state ^ mix(index.wrapping_add(0x9E37_79B9_7F4A_7C15)))
    })
}

/// An index for [`derive`](fn@derive) made from a name, so that a named item draws the same
/// numbers wherever it stands in a list.
pub fn index_of(name: &str) -> u64 {
    name.bytes().fold(mix(name.len() as u64), |state, byte| mix(state ^ u64::from(byte)))
}

fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_give_different_seeds_and_the_same_path_the_same_seed() {
        let mut seen: Vec<u64> =
            (0..1000).flat_map(|i| (0..10).map(move |j| derive(7, &[i, j]))).collect();
        assert_eq!(derive(7, &[3, 4]), derive(7, &[3, 4]));
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 10_000);
        assert_ne!(derive(7, &[1, 2]), derive(7, &[2, 1]));
    }

    #[test]
    fn names_have_indices_of_their_own() {
        let names = ["", "a", "b", "ab", "ba", "sand", "salt", "sodium_bicarbonate"];
        let mut seen = names.map(index_of);
        seen.sort_unstable();
        assert!(seen.windows(2).all(|pair| pair[0] != pair[1]));
        assert_eq!(index_of("sand"), index_of(&["sa", "nd"].concat()));
    }
}
