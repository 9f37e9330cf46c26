/* soak.c -- the firmware over hours of simulated driving, with random faults of bus, clock and vehicle, on one target. Plain C99, no libc.
 *
 * The vehicle is the nominal model with small changes from hour to hour, at speeds within, above and below the controller's range. This
 * program checks rules, not detection. It counts the violations of each rule:
 *
 *   report    each accepted tick sends one protected report with the next counter
 *   live      supervision is live again SETTLED_MS after the newest fault of the bus or the clock
 *   not_live  supervision is not live while a needed message has been lost for longer than LOST_MS
 *   verdict   the verdict is not valid or degraded if supervision has not been live for STALE_MS; invalid stays until acknowledged
 *   release   the demand is zero RELEASE_MS after the end of an engagement
 *   alarm     an alarm begins only during a fault of the vehicle, or up to ALARM_MS after its end
 *   missed    a fault of the vehicle during FOUND_MS of engaged driving, without another fault, causes an alarm
 *   engaged   without faults and within the controller's range, the loop is engaged from ENGAGED_MS after the start on
 *
 * Each hour writes one line: the driving, the messages and counts, a digest of all sent frames, the instructions of the worst tick and
 * the depth of the stack. Except for the last two, the lines for one length and seed are the same on every target. soak_input.h
 * states SOAK_HOURS, SOAK_HOUR_MS (shorter in a short run), SOAK_SEED and SOAK_FAULTS (0u: no faults, and speeds within the range). */
#include <string.h>

#include "firmware.h"
#include "lpvg_can_codec.h"
#include "lpvguard/model.h"
#include "port.h"
#include "soak_input.h"

#define TICK_MS 10
#define SETTLED_MS 3000
#define LOST_MS 1500
#define STALE_MS 200
#define RELEASE_MS 3000
#define ALARM_MS 90000
#define FOUND_MS 45000
#define ENGAGED_MS 2500
#define FRAMES 64u

typedef enum fault_t {
    fault_none,
    fault_lost,
    fault_flipped,
    fault_stuck,
    fault_twice,
    fault_short,
    fault_foreign,
    fault_bus_off,
    fault_late,
    fault_gap,
    fault_jump,
    fault_count
} fault_t;

typedef enum rule_t {
    rule_report,
    rule_live,
    rule_not_live,
    rule_verdict,
    rule_release,
    rule_alarm,
    rule_missed,
    rule_engaged,
    rule_count
} rule_t;

static const char* const rule_name[rule_count] = {"report", "live", "not_live", "verdict", "release", "alarm", "missed", "engaged"};

typedef struct hour_t {
    uint32_t ticks, engaged, valid, judged, faults, vehicle_faults, alarms, frames_in, frames_out, refused, worst;
} hour_t;

/* All state is static, so memory cannot grow. */
static firmware_t firmware;
static lpvg_model_t model;
static lpvg_can_frame_t queue[FRAMES];
static size_t queued, taken;
static uint64_t noise_state = SOAK_SEED, digest = 0xCBF29CE484222325u;
static int64_t now_us, clock_off_us;
static hour_t hour;
static uint32_t broken[rule_count];

/* --- numbers --- */

static uint32_t random_bits(void) {
    noise_state ^= noise_state << 13;
    noise_state ^= noise_state >> 7;
    noise_state ^= noise_state << 17;
    return (uint32_t)(noise_state >> 32);
}

static uint32_t below(uint32_t n) { return (uint32_t)(((uint64_t)random_bits() * n) >> 32); }

static float between(float low, float high) { return low + (high - low) * (float)(random_bits() >> 8) * (1.0f / 16777216.0f); }

/* --- text --- */

static char line[600];
static size_t at;

static void put(const char* text) {
    while (*text != '\0' && at + 2u < sizeof line) {
        line[at++] = *text++;
    }
    line[at] = '\0';
}

static void put_number(const char* name, uint64_t value) {
    char digits[21];
    size_t n = sizeof digits;
    digits[--n] = '\0';
    do {
        digits[--n] = (char)('0' + (char)(value % 10u));
        value /= 10u;
    } while (value > 0u);
    put(" ");
    put(name);
    put(" ");
    put(&digits[n]);
}

static void write_line(void) {
    put("\n");
    port_write(line);
    at = 0u;
}

/* --- the bus --- */

static void send_to_firmware(const lpvg_can_frame_t* frame) {
    if (queued < FRAMES) {
        queue[queued] = *frame;
        queue[queued].t_us = now_us + clock_off_us;
        ++queued;
        ++hour.frames_in;
    }
}

static float demand;
static uint8_t verdict, supervision, engagement, counter_due;
static uint32_t reports;

static bool take_from_firmware(void* driver, const lpvg_can_frame_t* frame) {
    size_t i;
    (void)driver;
    ++hour.frames_out;
    for (i = 0u; i < 8u; ++i) {
        digest = (digest ^ frame->data[i]) * 0x100000001B3u;
    }
    if (frame->id == LPVG_CAN_GUARD_OUT_ID) {
        lpvg_can_guard_out_t said;
        uint8_t counter = 0u;
        float number = 0.0f;
        ++reports;
        if (lpvg_can_e2e_check(frame, LPVG_CAN_GUARD_OUT_E2E_DATA_ID, &counter) != lpvg_status_ok || counter != counter_due ||
            lpvg_can_guard_out_unpack(&said, frame) != lpvg_status_ok ||
            lpvg_can_decode(&lpvg_can_guard_out_dp_demand, said.dp_demand, &number) != lpvg_can_quality_good) {
            ++broken[rule_report];
        } else {
            demand = number;
            verdict = (uint8_t)said.monitor_verdict;
            supervision = (uint8_t)said.supervision_state;
            engagement = (uint8_t)said.engagement;
        }
        counter_due = (uint8_t)((counter_due + 1u) % LPVG_CAN_COUNTERS);
    }
    return true;
}

static bool give_to_firmware(void* driver, int64_t at_us, lpvg_can_frame_t* frame) {
    (void)driver;
    (void)at_us;
    if (taken == queued) {
        queued = taken = 0u;
        return false;
    }
    *frame = queue[taken++];
    return true;
}

/* --- faults --- */

static struct {
    fault_t kind;
    uint8_t message; /* 0 VDC2, 1 GUARD_IN, 2 EBC2, 3 EBC1 */
    int32_t left_ms, wait_ms;
    int32_t lost_ms;  /* time for which the message has been lost */
    int32_t quiet_ms; /* time since the newest fault */
    lpvg_can_frame_t held;
    bool holds;
} fault = {.wait_ms = 20000};

static struct {
    int32_t left_ms, wait_ms, since_ms;
    int32_t engaged_ms, longest_ms; /* engaged time without a fault of the bus; longest such time */
    float gain;
    bool alarmed;
} wear = {.wait_ms = 600000, .since_ms = ALARM_MS, .gain = 1.0f};

static void next_faults(void) {
    if (fault.left_ms > 0) {
        fault.left_ms -= TICK_MS;
        fault.lost_ms += TICK_MS;
        fault.quiet_ms = 0;
    } else {
        fault.kind = fault_none;
        fault.lost_ms = 0;
        fault.quiet_ms += fault.quiet_ms < 1000000 ? TICK_MS : 0;
        fault.wait_ms -= SOAK_FAULTS > 0u ? TICK_MS : 0;
        if (fault.wait_ms <= 0) {
            fault.kind = (fault_t)(1u + below((uint32_t)fault_count - 1u));
            /* In messages without protection, a change that no check can see counts as a fault of a sensor. */
            fault.message = fault.kind == fault_flipped || fault.kind == fault_stuck || fault.kind == fault_late ? 1u : (uint8_t)below(4u);
            fault.left_ms = (int32_t)(TICK_MS * (1u + below(below(4u) == 0u ? 500u : 30u)));
            fault.wait_ms = (int32_t)(2000u + below(60000u));
            fault.holds = false;
            fault.quiet_ms = 0;
            ++hour.faults;
        }
    }
    wear.since_ms += wear.since_ms < ALARM_MS ? TICK_MS : 0;
    if (wear.left_ms > 0) {
        wear.left_ms -= TICK_MS;
        wear.since_ms = 0;
        wear.engaged_ms = fault.quiet_ms > 0 && engagement == (uint8_t)lpvg_ecu_engaged ? wear.engaged_ms + TICK_MS : 0;
        wear.longest_ms = wear.engaged_ms > wear.longest_ms ? wear.engaged_ms : wear.longest_ms;
        if (wear.left_ms <= 0) {
            wear.gain = 1.0f;
            broken[rule_missed] += !wear.alarmed && wear.longest_ms > FOUND_MS ? 1u : 0u;
        }
    } else {
        wear.wait_ms -= SOAK_FAULTS > 0u ? TICK_MS : 0;
        if (wear.wait_ms <= 0) {
            wear.gain = between(0.2f, 0.4f);
            wear.left_ms = 90000;
            wear.wait_ms = (int32_t)(900000u + below(1200000u));
            wear.engaged_ms = wear.longest_ms = 0;
            wear.alarmed = false;
            ++hour.vehicle_faults;
        }
    }
}

static void send_message(uint8_t message, lpvg_can_frame_t* frame) {
    const bool hit = fault.message == message;
    uint32_t i;
    switch (fault.kind) {
        case fault_lost:
            if (hit) {
                return;
            }
            break;
        case fault_flipped:
            if (hit) {
                frame->data[below(8u)] ^= (uint8_t)(1u << below(8u));
            }
            break;
        case fault_stuck:
            if (hit) {
                fault.held = fault.holds ? fault.held : *frame;
                fault.holds = true;
                *frame = fault.held;
            }
            break;
        case fault_twice:
            if (hit) {
                send_to_firmware(frame);
            }
            break;
        case fault_short: frame->dlc = hit ? (uint8_t)below(8u) : frame->dlc; break;
        case fault_foreign:
            for (i = 0u; i < 4u; ++i) {
                lpvg_can_frame_t other = *frame;
                other.id = LPVG_CAN_EXTENDED | (random_bits() & 0x1FFFFFFFu);
                other.data[below(8u)] = (uint8_t)random_bits();
                send_to_firmware(&other);
            }
            break;
        case fault_bus_off: {
            lpvg_can_frame_t report;
            memset(&report, 0, sizeof report);
            report.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
            report.dlc = 8u;
            if (fault.holds) {
                return;
            }
            fault.holds = true;
            send_to_firmware(&report);
            return;
        }
        case fault_late:
            if (hit) {
                const lpvg_can_frame_t newest = *frame;
                const bool held = fault.holds;
                *frame = fault.held;
                fault.held = newest;
                fault.holds = true;
                if (!held) {
                    return;
                }
            }
            break;
        default: break;
    }
    send_to_firmware(frame);
}

/* --- the vehicle --- */

static float speed = 12.0f, wanted_speed = 12.0f, acceleration = 0.5f, pressure, gain_of_hour[LPVG_NY], noise;
static float wave[4][2];
static lpvg_real_t outputs[LPVG_NY];
static uint8_t protection;
static int32_t request_ms;

static void start_hour(void) {
    size_t j;
    memset(&hour, 0, sizeof hour);
    for (j = 0u; j < LPVG_NY; ++j) {
        gain_of_hour[j] = between(0.98f, 1.02f);
    }
    noise = between(0.0f, 0.0002f);
    port_stack_paint();
}

/* Sensor values, and the motion of the vehicle after the firmware's answer. */
static void move(void) {
    const lpvg_real_t u = demand;
    pressure += (demand - pressure) * 0.01f / 0.15f;
    lpvg_model_advance(&model, &lpvg_coeff, speed, &u);
}

static void drive(void) {
    /* cos and sin of 0.6, 1.1, 2.0 and 3.3 rad/s over a tick */
    static const float turn[4][2] = {
        {0.99998200f, 0.00599996f}, {0.99993950f, 0.01099978f}, {0.99980001f, 0.01999867f}, {0.99945555f, 0.03299401f}};
    float change = acceleration * 0.01f;
    size_t i;
    for (i = 0u; i < 4u; ++i) {
        const float c = wave[i][0] * turn[i][0] - wave[i][1] * turn[i][1];
        const float s = wave[i][1] * turn[i][0] + wave[i][0] * turn[i][1];
        const float grows = 1.5f - 0.5f * (c * c + s * s);
        wave[i][0] = c * grows;
        wave[i][1] = s * grows;
    }
    if (below(20000u) == 0u) {
        wanted_speed = SOAK_FAULTS > 0u ? between(6.0f, 24.0f) : between(8.5f, 21.5f);
        acceleration = between(0.05f, 1.0f);
    }
    change = wanted_speed > speed ? change : -change;
    speed += (wanted_speed - speed) * (wanted_speed - speed) > change * change ? change : wanted_speed - speed;
    lpvg_model_output(&model, &lpvg_coeff, outputs);
    for (i = 0u; i < LPVG_NY; ++i) {
        outputs[i] = gain_of_hour[i] * (i == 0u ? wear.gain : 1.0f) * outputs[i] + between(-noise, noise);
    }
}

static void send_frames(int64_t tick) {
    lpvg_can_frame_t frame;
    lpvg_can_vdc2_t vdc2;
    lpvg_can_guard_in_t guard;
    const float command = 0.035f * (wave[0][0] + wave[1][0] + wave[2][0] + wave[3][0]);
    bool packed;
    memset(&frame, 0, sizeof frame);
    memset(&vdc2, 0, sizeof vdc2);
    memset(&guard, 0, sizeof guard);
    vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, 20.0f * outputs[1]);
    vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, outputs[0]);
    /* Signals that a fault of the yaw-rate sensor does not change. */
    vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, outputs[0] * speed);
    vdc2.longitudinal_acceleration = lpvg_can_encode(&lpvg_can_vdc2_longitudinal_acceleration, 0.0f);
    packed = lpvg_can_vdc2_pack(&vdc2, &frame) == lpvg_status_ok;
    send_message(0u, &frame);
    /* Asks for release during the first half second, and while the loop is locked. Then acknowledges, if the vehicle has no fault. */
    request_ms = engagement == (uint8_t)lpvg_ecu_locked && request_ms > 20000 && wear.left_ms <= 0 ? 0 : request_ms + TICK_MS;
    guard.control_request = request_ms < 250   ? LPVG_BUS_REQUEST_RELEASE
                            : request_ms < 500 ? LPVG_BUS_REQUEST_ACKNOWLEDGE
                                               : LPVG_BUS_REQUEST_CONTROL;
    guard.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, pressure);
    guard.yaw_rate_command = lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, command);
    packed = packed && lpvg_can_guard_in_pack(&guard, &frame) == lpvg_status_ok &&
             lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &protection) == lpvg_status_ok;
    send_message(1u, &frame);
    if (tick % 10 == 0) {
        lpvg_can_ebc2_t ebc2;
        lpvg_can_ebc1_t ebc1;
        memset(&ebc2, 0xFF, sizeof ebc2);
        memset(&ebc1, 0, sizeof ebc1);
        ebc2.front_axle_speed = lpvg_can_encode(&lpvg_can_ebc2_front_axle_speed, speed * 3.6f);
        packed = packed && lpvg_can_ebc2_pack(&ebc2, &frame) == lpvg_status_ok;
        send_message(2u, &frame);
        ebc1.brake_pedal_position = lpvg_can_encode(&lpvg_can_ebc1_brake_pedal_position, 0.0f);
        packed = packed && lpvg_can_ebc1_pack(&ebc1, &frame) == lpvg_status_ok;
        send_message(3u, &frame);
    }
    broken[rule_report] += packed ? 0u : 1u;
}

/* --- rules --- */

static int32_t dead_ms, released_ms;
static int64_t alarm_us;
static uint8_t said; /* verdict of the previous tick */

/* Alarm of the falsifying tests or the change test. The verdict lasts longer than the alarm. */
static int64_t newest_alarm_us(void) {
    const lpvg_monitor_t* const monitor = &firmware.ecu.monitor;
    const int64_t falsified = monitor->has_falsified ? monitor->t_falsified_us : 0;
    const int64_t changed = monitor->has_changed ? monitor->t_changed_us : 0;
    return falsified > changed ? falsified : changed;
}

static void judge(void) {
    const bool live = supervision == (uint8_t)lpvg_can_state_live;
    const bool engaged = engagement == (uint8_t)lpvg_ecu_engaged;
    const bool valid = verdict == (uint8_t)lpvg_verdict_valid;
    const bool alarm = verdict == (uint8_t)lpvg_verdict_invalid || verdict == (uint8_t)lpvg_verdict_degraded;
    dead_ms = live ? 0 : dead_ms + TICK_MS;
    released_ms = engaged ? 0 : released_ms + TICK_MS;
    hour.engaged += engaged ? 1u : 0u;
    hour.valid += valid ? 1u : 0u;
    hour.judged += valid || alarm ? 1u : 0u;
    broken[rule_live] += fault.quiet_ms > SETTLED_MS && !live ? 1u : 0u;
    broken[rule_not_live] += fault.kind == fault_lost && fault.lost_ms > LOST_MS && live ? 1u : 0u;
    broken[rule_verdict] += dead_ms > STALE_MS && (valid || verdict == (uint8_t)lpvg_verdict_degraded) ? 1u : 0u;
    broken[rule_engaged] += SOAK_FAULTS == 0u && released_ms > ENGAGED_MS ? 1u : 0u;
    broken[rule_release] += released_ms > RELEASE_MS && (demand > 0.001f || demand < -0.001f) ? 1u : 0u;
    if (newest_alarm_us() > alarm_us || (verdict == (uint8_t)lpvg_verdict_invalid && said != verdict)) {
        /* A continuing alarm counts once. The watch of the response makes the verdict invalid without a time of the monitor. */
        hour.alarms += newest_alarm_us() <= alarm_us || newest_alarm_us() - alarm_us > 1000000 ? 1u : 0u;
        alarm_us = newest_alarm_us() > alarm_us ? newest_alarm_us() : alarm_us;
        wear.alarmed = wear.alarmed || wear.left_ms > 0;
        broken[rule_alarm] += wear.since_ms >= ALARM_MS ? 1u : 0u;
    }
    said = verdict;
}

static void tick(int64_t number) {
    static bool jumped;
    const uint32_t before = reports;
    uint32_t begin, instructions;
    lpvg_status_t status;
    next_faults();
    if (fault.kind == fault_jump && !jumped) {
        clock_off_us += (int64_t)(2000000u + below(60000000u));
    }
    jumped = fault.kind == fault_jump;
    drive();
    send_frames(number);
    if (fault.kind == fault_gap) {
        move();
        return;
    }
    begin = port_counter();
    status = firmware_tick(&firmware, now_us + clock_off_us);
    instructions = port_instructions(begin, port_counter());
    firmware_idle(&firmware);
    move();
    hour.worst = instructions > hour.worst ? instructions : hour.worst;
    hour.refused += status == lpvg_status_ok ? 0u : 1u;
    broken[rule_report] += reports != before + (status == lpvg_status_ok ? 1u : 0u) ? 1u : 0u;
    judge();
}

static uint32_t total_broken(void) {
    uint32_t sum = 0u;
    size_t i;
    for (i = 0u; i < rule_count; ++i) {
        sum += broken[i];
    }
    return sum;
}

static void write_hour(uint32_t number) {
    put("hour");
    put_number("number", number);
    put_number("ticks", hour.ticks);
    put_number("engaged", hour.engaged);
    put_number("valid", hour.valid);
    put_number("judged", hour.judged);
    put_number("faults", hour.faults);
    put_number("vehicle_faults", hour.vehicle_faults);
    put_number("alarms", hour.alarms);
    put_number("frames_in", hour.frames_in);
    put_number("frames_out", hour.frames_out);
    put_number("refused", hour.refused);
    put_number("diagnosed", firmware.diagnosis.alarms);
    put_number("digest", digest);
    put_number("broken", total_broken());
    put_number("worst", hour.worst);
    put_number("stack", port_stack_used());
    write_line();
}

/* Ignition off and on between two hours. A repeated invalid verdict after an acknowledgement lasts until then. */
static void restart(const bus_t* bus) {
    broken[rule_report] += firmware_init(&firmware, bus, &firmware_config, NULL, now_us + clock_off_us) == lpvg_status_ok ? 0u : 1u;
    counter_due = 0u;
    alarm_us = 0;
    fault.quiet_ms = request_ms = dead_ms = 0;
}

int main(void) {
    const bus_t bus = {NULL, take_from_firmware, give_to_firmware};
    const lpvg_real_t still[LPVG_NY] = {0};
    const lpvg_real_t no_input[LPVG_NU] = {0};
    uint32_t number;
    int64_t tick_number = 0;
    size_t i;
    port_counter_start();
    for (i = 0u; i < 4u; ++i) {
        wave[i][0] = 1.0f;
    }
    lpvg_model_start(&model, &lpvg_coeff, no_input, still);
    if (firmware_init(&firmware, &bus, &firmware_config, NULL, 0) != lpvg_status_ok) {
        port_write("the firmware refused its coefficients\n");
        return 2;
    }
    for (number = 1u; number <= SOAK_HOURS; ++number) {
        if (number > 1u) {
            restart(&bus);
        }
        start_hour();
        for (hour.ticks = 0u; hour.ticks < SOAK_HOUR_MS / TICK_MS; ++hour.ticks) {
            now_us += TICK_MS * 1000;
            tick(tick_number++);
        }
        write_hour(number);
    }
    for (i = 0u; i < rule_count; ++i) {
        put("rule ");
        put(rule_name[i]);
        put_number("broken", broken[i]);
        write_line();
    }
    port_write("end\n");
    return 0;
}
