//! The models that can be fitted, and which options apply to which.

use std::cmp::Reverse;

use clap::builder::Arg;
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches, ValueEnum};

use super::{factor, gated, ggx, hybrid, neural, spherical};
use crate::Usage;

/// A model that can be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ModelName {
    /// The analytic BRDF alone: Lambert and GGX
    Ggx,
    /// The analytic BRDF, corrected by a network
    Hybrid,
    /// A network with learned shading frames
    Neural,
    /// Tables over single angles; no network and no gradients
    Factor,
    /// Features in tables on hemispheres, decoded by a small network: tens of kilobytes a material, near the
    /// measurement's own noise
    Spherical,
    /// Texture maps, corrected at every scale by latent codes, angular textures and a small network: a surface
    Gated,
}

/// What was chosen, with its options.
pub enum Choice {
    /// A model of BRDFs.
    Brdf(Chosen),
    /// A model of surfaces.
    Surface(gated::GatedArguments),
}

/// The options of the model of BRDFs that was chosen.
pub enum Chosen {
    Ggx(ggx::GgxArguments),
    Hybrid(hybrid::HybridArguments),
    Neural(neural::NeuralArguments),
    Factor(factor::FactorArguments),
    Spherical(spherical::SphericalArguments),
}

impl ModelName {
    /// Whether it has a network whose size can be chosen.
    #[must_use]
    pub fn has_network(self) -> bool {
        self.options().iter().any(|option| option.get_id() == "net")
    }

    /// As the command line spells it.
    #[must_use]
    pub fn name(self) -> String {
        self.to_possible_value().expect("every model has a name").get_name().to_owned()
    }

    /// The options that apply to it, besides those that apply to all.
    fn options(self) -> Vec<Arg> {
        let command = Command::new("");
        let command = match self {
            ModelName::Ggx => ggx::GgxArguments::augment_args(command),
            ModelName::Hybrid => hybrid::HybridArguments::augment_args(command),
            ModelName::Neural => neural::NeuralArguments::augment_args(command),
            ModelName::Factor => factor::FactorArguments::augment_args(command),
            ModelName::Spherical => spherical::SphericalArguments::augment_args(command),
            ModelName::Gated => gated::GatedArguments::augment_args(command),
        };
        command.get_arguments().cloned().collect()
    }

    /// What its options were given.
    ///
    /// # Errors
    /// An option that does not apply to it.
    pub fn read(self, matches: &ArgMatches) -> anyhow::Result<Choice> {
        self.refuse_others(matches)?;
        let chosen = match self {
            ModelName::Ggx => Chosen::Ggx(FromArgMatches::from_arg_matches(matches)?),
            ModelName::Hybrid => Chosen::Hybrid(FromArgMatches::from_arg_matches(matches)?),
            ModelName::Neural => Chosen::Neural(FromArgMatches::from_arg_matches(matches)?),
            ModelName::Factor => Chosen::Factor(FromArgMatches::from_arg_matches(matches)?),
            ModelName::Spherical => Chosen::Spherical(FromArgMatches::from_arg_matches(matches)?),
            ModelName::Gated => return Ok(Choice::Surface(FromArgMatches::from_arg_matches(matches)?)),
        };
        Ok(Choice::Brdf(chosen))
    }

    fn refuse_others(self, matches: &ArgMatches) -> Result<(), Usage> {
        for (option, models) in options() {
            let is_given = matches.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine);
            if is_given && !models.contains(&self) {
                return Err(Usage(format!(
                    "--{} does not apply to --model {}, but to {}",
                    option.get_long().expect("options of models have long names"),
                    self.name(),
                    listed(&models)
                )));
            }
        }
        Ok(())
    }
}

/// The options of all models, each once and under a heading that names the models that it applies to. Those that
/// apply to many come first.
pub fn augment(command: Command) -> Command {
    let mut options = options();
    options.sort_by_key(|(_, models)| Reverse(models.len()));
    let headed =
        |(option, models): (Arg, Vec<_>)| option.help_heading(format!("Options of {}", listed(&models)));
    command.args(options.into_iter().map(headed))
}

/// The options of all models, with the models that they apply to.
fn options() -> Vec<(Arg, Vec<ModelName>)> {
    let mut options: Vec<(Arg, Vec<ModelName>)> = Vec::new();
    for &model in ModelName::value_variants() {
        for option in model.options() {
            match options.iter_mut().find(|(other, _)| other.get_id() == option.get_id()) {
                Some((_, models)) => models.push(model),
                None => options.push((option, vec![model])),
            }
        }
    }
    options
}

/// "a, b and c".
fn listed(models: &[ModelName]) -> String {
    let names: Vec<String> = models.iter().map(|model| model.name()).collect();
    match &names[..] {
        [others @ .., last] if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => names.concat(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What two models define under one name has to be one option: the first definition parses and documents both.
    #[test]
    fn options_of_one_name_are_one_option() {
        for (option, models) in options() {
            for model in models {
                let own = model.options();
                let own = own.iter().find(|own| own.get_id() == option.get_id()).unwrap();
                let spelled = |option: &Arg| {
                    let text = |help: &clap::builder::StyledStr| help.to_string();
                    let help = option.get_long_help().or(option.get_help()).map(text);
                    (option.get_long().map(str::to_owned), help, option.get_default_values().to_vec())
                };
                assert_eq!(spelled(own), spelled(&option), "{model:?}");
            }
        }
    }

    #[test]
    fn networks_are_told_by_their_option() {
        let with: Vec<_> = ModelName::value_variants().iter().filter(|model| model.has_network()).collect();
        assert_eq!(with, [&ModelName::Hybrid, &ModelName::Neural, &ModelName::Spherical, &ModelName::Gated]);
    }

    #[test]
    fn names_are_listed_as_a_sentence_has_them() {
        let [ggx, hybrid, neural] = [ModelName::Ggx, ModelName::Hybrid, ModelName::Neural];
        assert_eq!(listed(&[ggx]), "ggx");
        assert_eq!(listed(&[ggx, hybrid]), "ggx and hybrid");
        assert_eq!(listed(&[ggx, hybrid, neural]), "ggx, hybrid and neural");
    }
}
