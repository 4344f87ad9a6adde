//! The effects that can be hidden in balance readings.

/// The hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TraceFamily {
    /// Nothing.
    NullPlain,
    /// Nothing, in fifteen weighings with two readings after each shake.
    NullFew,
    /// Nothing, and some columns were not recorded.
    NullMissing,
    BalanceDrift,
    BalanceLag,
    MassUptake,
    Evaporation,
    BalanceStatic,
    VibrationNoise,
    SpoonHoldup,
    FillLevel,
    Densification,
    Actuator,
    /// The fill of the spoon acts and was not recorded: the mass poured goes with it, and so does
    /// the number of shakes.
    HiddenFill,
    /// Readings wander differently in each weighing: no cause of the catalogue.
    Wander,
}

impl TraceFamily {
    pub const NULLS: [Self; 3] = [Self::NullPlain, Self::NullFew, Self::NullMissing];
    /// One cause of the catalogue each.
    pub const SINGLES: [Self; 10] = [
        Self::BalanceDrift,
        Self::BalanceLag,
        Self::MassUptake,
        Self::Evaporation,
        Self::BalanceStatic,
        Self::VibrationNoise,
        Self::SpoonHoldup,
        Self::FillLevel,
        Self::Densification,
        Self::Actuator,
    ];
    pub const OTHERS: [Self; 2] = [Self::HiddenFill, Self::Wander];

    /// Name of the family; for a single cause, the cause's name in the catalogue.
    pub fn name(self) -> &'static str {
        match self {
            Self::NullPlain => "null_plain",
            Self::NullFew => "null_few",
            Self::NullMissing => "null_missing",
            Self::BalanceDrift => "balance_drift",
            Self::BalanceLag => "balance_lag",
            Self::MassUptake => "mass_uptake",
            Self::Evaporation => "evaporation",
            Self::BalanceStatic => "balance_static",
            Self::VibrationNoise => "vibration_noise",
            Self::SpoonHoldup => "spoon_holdup",
            Self::FillLevel => "fill_level",
            Self::Densification => "densification",
            Self::Actuator => "actuator",
            Self::HiddenFill => "hidden_fill",
            Self::Wander => "wander",
        }
    }

    /// The cause of the catalogue that is at work.
    pub fn mechanism(self) -> Option<&'static str> {
        match self {
            Self::NullPlain
            | Self::NullFew
            | Self::NullMissing
            | Self::HiddenFill
            | Self::Wander => None,
            single => Some(single.name()),
        }
    }
}
