"""The part of a project file that says what `lpvguard design` is asked for."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..base.documents import Fraction, Positive, StrictModel


class DesignSettings(StrictModel):
    """Step 8: objectives of Fig. 1 and the scheduled controller. W_t, W_u: gain A_t, A_u and the paper's
    break frequencies.

    Weights are gain * prod(s/zero + 1) / prod(s/pole + 1), rad/s. ``nodes``: scheduling speeds of the
    controller, uniform over the model's range. ``synthesised_for`` [A_t, A_u]: what the controller is
    synthesised for where that is not what it is certified for; a higher A_t can leave room for a moving
    speed. ``table``: the objectives [A_t, A_u] of Table II; ``lambda_s`` [s^2]: weight of the state
    uncertainty beside the input's in (8), Lambda_nu = diag(1, lambda_s), for its K_is. ``input_max`` [input
    unit] and ``input_rate_max_per_s`` limit the demand; ``lateral_acceleration_max_mps2``, where given,
    limits it further over speed: the nominal model's steady yaw rate, the first output, times the speed stays
    within it (control/input_limit.py).
    ``amplitudes``: edges of the classes of the demand's amplitude [unit of the input], at which `bench
    robust` measures; None: its own.
    """

    structure: Literal["K_inf", "K_i", "K_is", "K_o"] = "K_i"
    A_t: Positive
    A_u: Positive
    W_t_zeros: list[Positive] = Field(default=[10.0])
    W_t_poles: list[Positive] = Field(default=[0.02])
    W_u_zeros: list[Positive] = Field(default=[0.02, 0.02])
    W_u_poles: list[Positive] = Field(default=[50.0, 50.0])
    W_R_num: list[float] = Field(default=[9.0])
    W_R_den: list[float] = Field(default=[1.0, 5.4, 9.0])
    design_speed_mps: Positive = 17.0
    nodes: Annotated[int, Field(ge=2, le=64)] = 8
    synthesised_for: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = None
    backoff: Fraction = 0.05
    order_loss: Fraction = 0.005
    table: list[Annotated[list[Positive], Field(min_length=2, max_length=2)]] | None = None
    lambda_s: Positive = 1.0
    amplitudes: Annotated[list[Positive], Field(min_length=1)] | None = None
    input_max: list[Positive]
    lateral_acceleration_max_mps2: Positive | None = None
    input_rate_max_per_s: list[Positive]

    @property
    def for_synthesis(self) -> DesignSettings:
        """With the A_t and A_u that the controller is synthesised for."""
        A_t, A_u = self.synthesised_for or (self.A_t, self.A_u)
        return self.model_copy(update={"A_t": A_t, "A_u": A_u})

    @property
    def objectives(self) -> list[tuple[float, float]]:
        """(A_t, A_u) of Table II's columns: the table's, or as in the paper A_t with A_u, 75/95 of A_t, and a
        tenth of A_u."""
        own = [[self.A_t, self.A_u], [self.A_t * 75 / 95, self.A_u], [self.A_t, self.A_u / 10]]
        return [(A_t, A_u) for A_t, A_u in (self.table or own)]
