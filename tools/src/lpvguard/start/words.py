"""Words in names of signals: what a speed, a steering angle and a yaw rate are called, and what they are not.

Each list holds regular expressions for a name in lower case, whose words are joined by _.
"""

import re


def _any(expressions: str) -> str:
    """One expression for any of several."""
    return "|".join(expressions.split())


GREEK = str.maketrans({"δ": "delta", "ψ": "psi", "ω": "omega", "\u0307": "_dot"})
"""Letters in names, and the dot above one."""
WORDS = {
    "speed": (
        _any(
            r"^(v|vx|v_x|vel|speed|v_?ego|ego_?v)$ ^(longitudinal|forward)_(speed|vel) "
            r"(vehicle|veh|car|ego)_?(speed|spd|velocity) vitesse_?v[eé]h fahr(zeug)?_?geschw"
        ),
        _any(
            r"linear_(vel_)?x (^|_)v_?x(_|$) ^v_?(fzg|kfz|auto)(_|$) speed spd veloc (^|_)vel(_|$) ^vel "
            r"geschw vitesse (^|_)v_signal veh_?v_ ^(u|v_?long?|v_gps|sog|tempo|tacho)(_|$) "
            r"((^|_)v|vit)_?veh(_|$) ^veh_v$ ^vfz ^h\u0131z snelheid hastighet rychlost pr[eę]dko[sś] "
            r"velocid velocit 车速"
        ),
    ),
    "input": (
        _any(r"^(delta|steer|swa)$ road_?wheel (steer|steering)_?(wheel|whl)?_?ang(le)?(_|$)"),
        _any(
            r"steer (^|_)delta(_|$) wheel_?angle lenk volant braquage (^|_)sterz (^|_)(lws|sas)_(ang|wink) "
            r"internal_?sas _lrw$ ste(pin|whl).*_an st(r|rg|w)?_?(wheel|whl|wh|w)?_?angl? "
            r"strg?_?whl_?ag(_|$) ^ang(le)?_?(st(ee)?r|vol)(_|whl|$) (^|_)stea_ ^hw_?ang whl_?ang "
            r"^l(r?w|ws)$ (^sw|hand_?wheel)_?(pos|ang|deg|rad) ^(hwa|rwa)(_|$) "
            r"(servo|t[iy]re)_?(pos|angle) direcci[oó]n stuur ratt_?v skret kierown sterzo 方向盘 转角"
        ),
    ),
    "output": (
        _any(r"^(r|w_?z|yaw_?rate)$"),
        _any(
            r"yaw_?(rate|rte?|r$|vel|speed|spd|w_|dot|veh$) ang(ular)?_?(vel|rate|velocity|speed)_?z "
            r"gyro?(scope)?_?z omega_?z ^omega$ psi_?(dot|punkt|p$) ^d_?psi(_?dt)?$ ^gz(_|$) ^a_?v_?z$ "
            r"rot(ation)?_?(rate|speed|vel)?_?z(_|$) (^|_)rate_?(\w+_)?z(_|$) z_?(axis_)?rate_of_rot "
            r"^z_?rate(_|$) "
            r"(heading|turn)_?(rate|speed) (^|_)gyro$ _wz(_|$) gier lacet imbard gui[nñ] gir(asj|hast) 横摆"
        ),
    ),
}
"""By role: what a name is for certain, and what it may hold."""
OF_PATHS = {
    "speed": _any(r"twist_linear_x$ linear_velocity_x$"),
    "input": _any(
        r"ackermann.*steering_angle$ steer\w*_(rpt|report)_output$ "
        r"(steer|lenk|volant)\w*_(angle|ang|winkel|pos|position|value)$"
    ),
    "output": _any(
        r"(angular|ang(ular)?_?vel\w*|gyro\w*|rate\w*)_z$ yaw_(rate|value)$ "
        r"(ang(ular)?_?vel\w*|gyro\w*|rotation_?rate)(_xyz|_rad|_value|_v)?_2_?$"
    ),
}
"""By role: what the last words of a topic or message with its fields may be."""
WITH_UNIT = {"output": "yaw|gyro?|(^|_)rot(ation)?(_rate|_speed)?$"}
"""By role: what a name may hold where a unit of the role is stated."""
NEVER = {
    "speed": _any(
        r"_[yz](_|$) ^v_?[yz](_|$) (^|_)lat(eral)?_?(_|v|sp) rel(ative|_|sp|v) target trgt trg$ air_?sp "
        r"set_?(p|speed) wunsch ziel soll lead obj wiper fan wind_ engine idle shaft turbine motor_sp "
        r"rpm max lim lmt trap tsr saved condition offset regel abbruch zeit gier yaw lacet imbard gui[nñ] "
        r"ang steer lenk sas rate_ hud clu_ kombi angez dsply display navi expected"
    ),
    "input": _any(
        r"rate(?!d) torque couple coppia effort drehm tq trq speed spd vel gesch grd moment hilfe fraction "
        r"override volt "
        r"pressure hands hold assist warn config index menu flex ratio typ required verbau max"
    ),
    "output": _any(
        r"(^|_)[xy]_?(axis_)?(rate|rot|gyro) (gyro?|gyroscope|rot|rotation|rate)_?[xy](_|$) roll "
        r"pitch nick wank acc ang(le)?(_(?!vel|rate|speed)|$) target desired (^|_)ref trailer "
        r"trlr fehler"
    ),
}
"""By role: other quantities that share a word with it."""
NEVER_IN = {
    "speed": _any(
        r"(local|global)_position localization.*pose vehicle_odometry (^|_)(ned|enu)(_|$) attitude"
    ),
    "input": _any(r"imu gyro attitude local_position"),
    "output": "(?!)",
}
"""By role: messages without it. PX4's velocities are to the north and to the east."""
NOT = {
    "speed": _any(
        r"control desired cruise digital pcm cluster dash ui_ adas acc_? gps low mod_ "
        r"bump analog rough"
    ),
    "input": _any(r"calculated control motor _2$ rechts sw$ rel"),
    "output": _any(r"raw"),
}
"""By role: what lowers a name's rank. A command and a copy share its words."""
REQUEST = re.compile(_any(r"req cmd command target demand ^des(?!c) unknown"))
"""In names of what is asked for, and of what nobody knows: below every measurement."""
WHEEL = re.compile(_any(r"wheel whl rad_?geschw (^|_)roue rueda ruota"))
"""In names of the speed of one wheel."""
NO_MEASUREMENT = re.compile(
    _any(
        r"checksum crc counter cnt qf$ qbit valid status (^|_)sta(_|$) stat$ fault error button "
        r"icon mode units?$ sign(?!al) lamp force _rq offse?t direction (^|_)vz(_|$) limit diag "
        r"init group bias rate_?v$ speed_?v$ ack$ pressed reboot reduced dtcs?$"
    )
)
"""In names of what tells of a measurement, and is none."""
NO_ANGLE = re.compile(
    _any(
        r"percent pct % norm(?!al) pwm (^|_)adc duty ticks?(_|$) counts?$ volt "
        r"(^|_)(us|usec|mv)$"
    )
)
"""In names of a steering that is no angle yet: a share of full lock, a pulse, a voltage."""
OTHERS_MESSAGE = re.compile(
    _any(
        r"cmd command setpoint control (^|[_.])drive([_.]|$) lka lta acc cruise hud kombi "
        r"cluster object track radar cam_ das_ ipma nav gps tsk smgr tbd"
    )
)
"""In names of messages that carry a signal for another purpose."""
MEASURED_MESSAGE = re.compile(_any(r"feedback measured actual report odom sensor"))
"""In names of messages that carry a measurement, whatever its fields are called."""

STEERING_WHEEL = re.compile(
    _any(r"steering_?wheel hand_?wheel lenkrad ^swa _swa (^|_)lw[iz]?(_|$) volant rattv stuurw 方向盘")
)
ROAD_WHEEL = re.compile(_any(r"road_?wheel front_?wheel tyre tire"))
"""Names of an angle at the steering wheel, and of one at the road wheels."""
FRACTION = re.compile(_any(r"frac (^|_)fine(_|$) _hp$"))
"""In names of the digits beyond a coarse signal's resolution."""
ACCELERATION = re.compile(
    _any(
        r"lat(eral)?_acc acc(el(eration)?)?_lat ^(vehicle_)?a_?y(_|$) acc(el(eration)?)?_y "
        r"linear_acc\w*_y quer_?beschl"
    )
)
"""In names of a lateral acceleration."""
COURSE = re.compile(_any(r"(^|_)(course|cog|bearing|heading|kurs|azimuth|psi|yaw)(_angle|_deg|_rad)?$"))
"""In names of a course or a heading."""
SIDES = {
    "rl": "rr",
    "lr": "rr",
    "hl": "hr",
    "fl": "fr",
    "lf": "rf",
    "vl": "vr",
    "l": "r",
    "lh": "rh",
    "left": "right",
    "links": "rechts",
    "gauche": "droite",
}
"""Words of a left wheel, by language and axle, and of the right one."""
