//! `--device`: what a job simulates on.

use clap::ValueEnum;
use flip_core::domain::device::Device;

/// The option of commands whose job can simulate on a graphics card.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(super) struct DeviceArguments {
    /// What simulates: the processor, or a graphics card of this computer, of the server's or of a
    /// worker's. A card gives other bytes with the same statistics.
    #[arg(long, value_enum, default_value_t = DeviceFlag::Cpu)]
    device: DeviceFlag,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DeviceFlag {
    /// The processor.
    Cpu,
    /// A graphics card with CUDA.
    Cuda,
}

impl DeviceArguments {
    /// The device asked for.
    pub(super) fn device(self) -> Device {
        match self.device {
            DeviceFlag::Cpu => Device::Cpu,
            DeviceFlag::Cuda => Device::Cuda,
        }
    }
}
