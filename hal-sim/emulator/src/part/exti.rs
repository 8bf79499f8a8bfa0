//! External interrupts, lines 0 to 15: RM0090 chapter 12. Edges of pins, masks, PR, SWIER.
//!
//! Not modelled: events, and the lines above 15.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::exti::Register;

/// The interrupts of the instance by their position in the part's table (2, 6, 7, 8, 9, 10, 23, 40), each with the
/// lines that share it.
const INTERRUPTS: [(usize, u64); 7] = [
    (1, 1 << 0),
    (2, 1 << 1),
    (3, 1 << 2),
    (4, 1 << 3),
    (5, 1 << 4),
    (6, 0x03E0),
    (7, 0xFC00),
];

/// The controller.
#[derive(Debug, Default)]
pub(super) struct Exti {
    pending: u64,
    /// Level of each interrupt, by its place in [`INTERRUPTS`].
    high: [bool; INTERRUPTS.len()],
}

impl Exti {
    /// An edge on the pin that is chosen for a line.
    pub(super) fn edge(
        &mut self,
        line: u8,
        rising: bool,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let trigger = if rising { Register::Rtsr } else { Register::Ftsr };
        if registers.get(trigger) >> line & 1 == 1 {
            self.pending |= 1 << line;
            self.update(registers, context);
        }
    }

    fn update(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        registers.set(Register::Pr, self.pending);
        let unmasked = self.pending & registers.get(Register::Imr);
        for ((position, lines), high) in INTERRUPTS.into_iter().zip(&mut self.high) {
            let wanted = unmasked & lines != 0;
            if wanted != *high {
                *high = wanted;
                if wanted {
                    context.raise(position);
                } else {
                    context.lower(position);
                }
            }
        }
    }
}

impl Device for Exti {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        match register {
            // Cleared by writing one, and with it what the software had asked for.
            Register::Pr => {
                self.pending &= !value;
                let software = registers.get(Register::Swier);
                registers.set(Register::Swier, software & !value);
            }
            Register::Swier => self.pending |= value & registers.get(Register::Imr),
            _ => {}
        }
        self.update(registers, context);
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}
