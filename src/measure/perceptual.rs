//! Perceptual distance: how far a network's features of two pictures are apart (Johnson, Alahi, Fei-Fei 2016, which the paper's
//! Sec. 4.2 cites for its Table 1).

use crate::config::PerceptualConfig;
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use caphy_formats::onnx::{Element, Fit, Network, Placement, Tensor, Values};

/// A network, ready to look at pictures.
#[derive(Debug)]
pub struct Perceptual {
    network: Network,
    outputs: Vec<usize>,
    config: PerceptualConfig,
}

/// What a network sees in a picture: one tensor per output.
pub struct Features(Vec<Vec<f32>>);

impl Perceptual {
    /// Reads and opens the network.
    ///
    /// # Errors
    /// Those of [`Network::open`]; [`Error::Format`] for an output that is not there, or holds no floats; [`Error::Io`].
    pub fn open(config: &PerceptualConfig, files: &dyn Files) -> Result<Self> {
        let bytes = files.read(&config.path)?;
        let network = Network::open(PerceptualConfig::KEY, &config.path, &bytes, config.threads)?;
        let outputs = match &config.outputs[..] {
            [] => (0..network.outputs().len()).collect(),
            names => names.iter().map(|name| network.output(name)).collect::<Result<Vec<_>>>()?,
        };
        if let Some(port) = outputs.iter().map(|&i| &network.outputs()[i]).find(|p| p.element != Element::F32) {
            let problem = format!("{port} holds no features");
            let remedy = format!("name outputs of floats in `{}.outputs`", PerceptualConfig::KEY);
            return Err(Error::format(&config.path, "outputs", problem, remedy));
        }
        Ok(Self { network, outputs, config: config.clone() })
    }

    /// Features of a grey picture, brightness in [0, 1], shape [height · width].
    ///
    /// # Errors
    /// Those of [`Network::run`]; [`Error::NonFinite`] for features that are not finite.
    pub fn features(&self, brightness: &[f32], height: usize, width: usize) -> Result<Features> {
        let own = [height, width];
        let placement = Placement::new(own, self.network.size(None, own)?, Fit::Letterbox);
        let picture: Vec<[f32; 3]> = brightness.iter().map(|b| [*b; 3]).collect();
        // Nothing is shown beside the picture, as in it.
        let input = self.config.pixels.tensor(&picture, [0.0; 3], &placement)?;
        let answers = self.network.run(input, placement.input(), &self.outputs)?;
        let features = answers.into_iter().map(|Tensor { shape, values }| match values {
            Values::F32(values) => {
                Error::check_finite(&format!("features of {}", self.config.path.display()), &values)?;
                Ok(values)
            }
            Values::Integer(_) => {
                let problem = format!("integers of shape {shape:?} are no features");
                Err(Error::format(&self.config.path, "answer", problem, "export the features as floats"))
            }
        });
        Ok(Features(features.collect::<Result<_>>()?))
    }
}

impl Features {
    /// Sum over the outputs of ‖φ(a) − φ(b)‖² / (C H W), their Eq. 2; 0 for the same picture. The paper does not say which layers it
    /// takes, nor how it adds them.
    ///
    /// # Errors
    /// [`Error::Length`] for features of pictures of another size.
    pub fn distance(&self, other: &Self) -> Result<f64> {
        Error::check_length("features of two pictures, outputs", self.0.len(), other.0.len())?;
        let mut sum = 0.0;
        for (a, b) in self.0.iter().zip(&other.0) {
            Error::check_length("features of two pictures", a.len(), b.len())?;
            let squares: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
            sum += squares / a.len().max(1) as f64;
        }
        Ok(sum)
    }
}
