//! What can be hidden in balance readings.

/// What is hidden.
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
    /// The fill of the spoon acts and was not recorded: what is poured goes with it, and so does the number of shakes.
    HiddenFill,
    /// Readings wander, in each weighing in their own way: no cause of the catalogue.
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

    /// Name of the family; that of a single cause is the cause's in the catalogue.
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
            Self::NullPlain | Self::NullFew | Self::NullMissing | Self::HiddenFill | Self::Wander => None,
            single => Some(single.name()),
        }
    }
}
