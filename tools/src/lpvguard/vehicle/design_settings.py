"""Settings of `lpvguard design` in a project file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from ..base.documents import Fraction, Positive, StrictModel


class DesignSettings(StrictModel):
    """Settings of step 8: objectives of Fig. 1 and the gain-scheduled controller.

    Weights are gain * prod(s/zero + 1) / prod(s/pole + 1) with zeros and poles in rad/s. The gains are A_t
    and A_u; the default break frequencies are the paper's. A_u is the gain of the first input; the gain of a
    second input follows from the ratio of the rate limits.

    Attributes
    ----------
    controlled : str or None, output that follows the command, by default the first
    structure : str, uncertainty structure of the synthesis
    A_t, A_u : float, gains of W_t and W_u
    W_t_zeros, W_t_poles, W_u_zeros, W_u_poles : list of float, rad/s
    W_R_num, W_R_den : list of float, reference model
    design_speed_mps : float, m/s
    nodes : int, scheduling speeds, uniform over the model's range
    synthesised_for : [A_t, A_u] or None, targets of the synthesis if they differ from the certified ones
        A higher A_t can leave a reserve for a varying speed.
    backoff, order_loss : float, relative losses allowed in synthesis and order reduction
    table : list of [A_t, A_u] or None, columns of Table II
    lambda_s : float, s^2, weight of the state uncertainty in (8) for K_is: Lambda_nu = diag(1, lambda_s)
    amplitudes : list of float or None, edges of the amplitude classes of `bench robust` [input unit]
    input_max : list of float, limit of the demand [input unit]
    lateral_acceleration_max_mps2 : float or None
        Limits the demand over speed, so that steady yaw rate times speed stays below it
        (control/input_limit.py).
    input_rate_max_per_s : list of float, limit of the demand's rate [input unit/s]
    """

    controlled: str | None = None
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

    @model_serializer(mode="wrap")
    def _brief(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out ``controlled`` if it is None, because older settings do not have it."""
        return {k: v for k, v in plain(self).items() if k != "controlled" or v is not None}

    @property
    def for_synthesis(self) -> DesignSettings:
        """Copy of the settings with the A_t and A_u for the synthesis."""
        A_t, A_u = self.synthesised_for or (self.A_t, self.A_u)
        return self.model_copy(update={"A_t": A_t, "A_u": A_u})

    @property
    def objectives(self) -> list[tuple[float, float]]:
        """(A_t, A_u) of Table II's columns; by default three as in the paper (A_t lowered to 75/95, A_u to
        1/10)."""
        own = [[self.A_t, self.A_u], [self.A_t * 75 / 95, self.A_u], [self.A_t, self.A_u / 10]]
        return [(A_t, A_u) for A_t, A_u in (self.table or own)]
