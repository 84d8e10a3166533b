//! What the class numbers of human parsers mean.

use caphy_core::scan::Label;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Class numbers of a data set that parsers are trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelMap {
    /// Look into Person, 20 classes.
    Lip,
    /// ATR, 18 classes.
    Atr,
    /// PASCAL-Person-Part, 7 classes: parts of the body, not clothes. Torso and upper arms count as upper garment, legs as
    /// lower one, head and lower arms as body; give `classes` where the person wears something else.
    Pascal,
}

use Label::{Body, Ignore, Lower, Upper};

/// Background; hat, hair, glove, sunglasses; upper clothes, dress, coat; socks; pants, jumpsuits; scarf; skirt; face, arms, legs,
/// shoes. A dress or jumpsuit is one garment: the upper.
const LIP: [(&str, Label); 20] = [
    ("background", Ignore),
    ("hat", Body),
    ("hair", Body),
    ("glove", Body),
    ("sunglasses", Body),
    ("upper-clothes", Upper),
    ("dress", Upper),
    ("coat", Upper),
    ("socks", Body),
    ("pants", Lower),
    ("jumpsuits", Upper),
    ("scarf", Body),
    ("skirt", Lower),
    ("face", Body),
    ("left-arm", Body),
    ("right-arm", Body),
    ("left-leg", Body),
    ("right-leg", Body),
    ("left-shoe", Body),
    ("right-shoe", Body),
];

const ATR: [(&str, Label); 18] = [
    ("background", Ignore),
    ("hat", Body),
    ("hair", Body),
    ("sunglasses", Body),
    ("upper-clothes", Upper),
    ("skirt", Lower),
    ("pants", Lower),
    ("dress", Upper),
    ("belt", Lower),
    ("left-shoe", Body),
    ("right-shoe", Body),
    ("face", Body),
    ("left-leg", Body),
    ("right-leg", Body),
    ("left-arm", Body),
    ("right-arm", Body),
    ("bag", Ignore),
    ("scarf", Body),
];

const PASCAL: [(&str, Label); 7] = [
    ("background", Ignore),
    ("head", Body),
    ("torso", Upper),
    ("upper-arms", Upper),
    ("lower-arms", Body),
    ("upper-legs", Lower),
    ("lower-legs", Lower),
];

impl LabelMap {
    /// Names of the classes in the order of their numbers, and what they are here.
    pub fn classes(self) -> &'static [(&'static str, Label)] {
        match self {
            Self::Lip => &LIP,
            Self::Atr => &ATR,
            Self::Pascal => &PASCAL,
        }
    }
}

/// What each class number means: those of `map`, then single `classes` by number or by their name in `map`.
///
/// # Errors
/// [`Error::Config`] for a class that does not exist, and where none has a meaning.
pub(crate) fn class_labels(map: Option<LabelMap>, classes: &BTreeMap<String, Label>) -> Result<[Option<Label>; 256]> {
    let mut labels = [None; 256];
    let known = map.map_or(&[][..], LabelMap::classes);
    for (slot, (_, label)) in labels.iter_mut().zip(known) {
        *slot = Some(*label);
    }
    for (class, label) in classes {
        let number = class.parse::<u8>().ok().map(usize::from);
        let Some(number) = number.or_else(|| known.iter().position(|(name, _)| name == class)) else {
            let names: Vec<&str> = known.iter().map(|k| k.0).collect();
            let remedy = match names.is_empty() {
                true => "give numbers from 0 to 255, or a `map` that has names".to_string(),
                false => format!("give a number from 0 to 255, or one of {}", names.join(", ")),
            };
            return Err(Error::config("segmenter.classes", format!("there is no class `{class}`"), remedy));
        };
        labels[number] = Some(*label);
    }
    if labels.iter().all(Option::is_none) {
        let remedy = "give `map = \"lip\"`, \"atr\" or \"pascal\", or `classes = { 5 = \"upper\", … }`";
        return Err(Error::config("segmenter.map", "no class has a meaning", remedy));
    }
    Ok(labels)
}
