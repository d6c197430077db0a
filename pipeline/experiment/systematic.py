"""Errors that all devices of a tester or a session have in common, each known to a standard deviation.

    true clock       = declared (1 + 1e-6 clock_sd_ppm z)
    true temperature = declared + temperature_sd_c z            mode frequencies (1 + 1e-6 TCF dT) at the declared one
    true gain        = declared exp(gain_sd z)                  drive volts to pick-off volts, both channels together
    phi, kappa       = declared + phase_error_sd_deg z,  declared exp(angular_gain_sd z / declared)

with one z ~ N(0, 1) for each error, the same for all devices.  A standard deviation of 0 means that the value is exact.
``pipeline.inference.systematic`` gives what each error does to the quantities.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Temperature coefficient of the frequency of silicon resonators [ppm/K]; Hopcroft et al., J. MEMS 19 (2010) 229.
SILICON_TCF_PPM_PER_C = -28.0


@dataclass(frozen=True)
class Systematic:
    """Standard deviations of the common errors.

    Parameters
    ----------
    phase_error_sd_deg : of the demodulation phase error [deg].
    angular_gain_sd : of kappa = I_p / I_0p [1].
    gain_sd : of the gain from drive volts to pick-off volts, relative [1].
    clock_sd_ppm : of the sample rate, relative [ppm].
    temperature_sd_c : of the temperature during the test [K].
    tcf_ppm_per_c : temperature coefficient of the mode frequencies [ppm/K].
    """

    phase_error_sd_deg: float = 0.0
    angular_gain_sd: float = 0.0
    gain_sd: float = 0.0
    clock_sd_ppm: float = 0.0
    temperature_sd_c: float = 0.0
    tcf_ppm_per_c: float = SILICON_TCF_PPM_PER_C

    @property
    def sds(self) -> tuple[float, float, float, float, float]:
        """Phase error [deg], angular gain [1], gain [1], clock [ppm], temperature [K]."""
        return (
            self.phase_error_sd_deg,
            self.angular_gain_sd,
            self.gain_sd,
            self.clock_sd_ppm,
            self.temperature_sd_c,
        )

    @property
    def exact(self) -> bool:
        """Whether all standard deviations are 0."""
        return not any(self.sds)


#: A tester without common errors.
EXACT = Systematic()
