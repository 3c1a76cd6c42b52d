"""Texts of alarms: name, cause, consequence and response of each, their states, and what people do."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "alarm_text": "{name}. {response}",
    "alarm_value_text": "{name}: {value}. {response}",
    "alarm_unit_offline": "No response",
    "alarm_unit_offline_cause": "The unit has no power, its cable is open, or its address (#17) has changed.",
    "alarm_unit_offline_consequence": (
        "The drive keeps its last speed. It is neither monitored nor commanded from here."
    ),
    "alarm_unit_offline_response": "Check the power of the unit and its cable. Operate it at its keypad.",
    "alarm_link_degraded": "Poor connection",
    "alarm_link_degraded_cause": "A loose terminal, a missing termination or interference on the cable.",
    "alarm_link_degraded_consequence": "Values come late, and the connection may be lost.",
    "alarm_link_degraded_response": "Check terminals, shield and termination of the unit in this shift.",
    "alarm_estop_active": "Emergency stop active",
    "alarm_estop_active_cause": "An emergency stop was pressed, or its circuit is open.",
    "alarm_estop_active_consequence": "The drive stops; the web may break.",
    "alarm_estop_active_response": "Go to the machine, find the reason, and reset the stop there.",
    "alarm_not_at_speed": "Not at speed",
    "alarm_not_at_speed_cause": "The load is too high, the drive is at its limit, or the encoder failed.",
    "alarm_not_at_speed_consequence": "Tension is lost between this unit and its neighbors.",
    "alarm_not_at_speed_response": "Reduce the speed of the line, then check load and encoder of the unit.",
    "alarm_running_without_run": "Turning without run",
    "alarm_running_without_run_cause": "The web drives the motor, or the output stage does not switch off.",
    "alarm_running_without_run_consequence": "A person who trusts the standstill may be injured.",
    "alarm_running_without_run_response": "Keep people away from the machine and isolate the drive there.",
    "alarm_ratio_out_of_limits": "Ratio outside its limits",
    "alarm_ratio_out_of_limits_cause": "The ratio (#37) was changed, or its limits (#38, #31) were.",
    "alarm_ratio_out_of_limits_consequence": "The unit follows with another ratio than the one set.",
    "alarm_ratio_out_of_limits_response": "Set a ratio between #38 and #31, or correct the limits.",
    "alarm_not_in_remote": "Not in REMOTE",
    "alarm_not_in_remote_cause": "A person has switched the unit to LOCAL or KEYLOCK at its keypad.",
    "alarm_not_in_remote_consequence": "The unit rejects commands from here, also a change of the line.",
    "alarm_not_in_remote_response": "Check who operates the unit, and return it to REMOTE at its keypad.",
    "alarm_parameter_drift": "Differs from the golden set",
    "alarm_parameter_drift_cause": "A parameter was changed at the keypad or by a command.",
    "alarm_parameter_drift_consequence": "The unit ramps, follows or limits otherwise than approved.",
    "alarm_parameter_drift_response": "Compare the parameters. Restore the golden set, or approve a new one.",
    "alarm_duplicate_address": "Address may be used twice",
    "alarm_duplicate_address_cause": "Two units have the same address (#17), or one responds for another.",
    "alarm_duplicate_address_consequence": "Values may be those of another unit; a command may reach both.",
    "alarm_duplicate_address_response": "Do not command the unit. Check the addresses (#17) at the keypads.",
    "alarm_staged_left": "Staged setpoint not executed",
    "alarm_staged_left_cause": "A change was staged (82h) and neither executed nor withdrawn.",
    "alarm_staged_left_consequence": "The next broadcast (83h) moves the unit unexpectedly.",
    "alarm_staged_left_response": "Execute the setpoint, or stage the present speed again.",
    "alarm_deviation": "Speed deviates",
    "alarm_deviation_cause": (
        "The load is too high, the encoder failed, or the window of AT SPEED (#12) is too wide."
    ),
    "alarm_deviation_consequence": "The draw to the neighbors is wrong: the web slackens or breaks.",
    "alarm_deviation_response": "Reduce the speed of the line. Measure the speed at the roll.",
    "alarm_analog_out_of_limits": "Analog input at its limit",
    "alarm_analog_out_of_limits_cause": (
        "The transducer or its wire is broken, or the value is outside the range of the input."
    ),
    "alarm_analog_out_of_limits_consequence": "The value is no measurement; a trim by it is wrong.",
    "alarm_analog_out_of_limits_response": "Check transducer, wire and supply. Switch trim (#26) off.",
    "alarm_port_lost": "Port lost",
    "alarm_port_lost_cause": "The adapter was unplugged, has no power, or its network is interrupted.",
    "alarm_port_lost_consequence": "All drives of the bus keep their speed, neither monitored nor commanded.",
    "alarm_port_lost_response": "Check the adapter and its cable. Operate the units at their keypads.",
    "alarm_no_unit_responds": "No unit responds",
    "alarm_no_unit_responds_cause": (
        "The cable is open or unplugged, the units have no power, or their baud rate differs."
    ),
    "alarm_no_unit_responds_consequence": (
        "All drives of the bus keep their speed, neither monitored nor commanded."
    ),
    "alarm_no_unit_responds_response": (
        "Check the cable at the adapter and the power of the units. Operate them at their keypads."
    ),
    "alarm_worker_lost": "Bus worker lost",
    "alarm_worker_lost_cause": "The bus worker or its computer has stopped, or the network is interrupted.",
    "alarm_worker_lost_consequence": (
        "All drives of the bus keep their speed, neither monitored nor commanded."
    ),
    "alarm_worker_lost_response": "Check the computer of the bus worker and its network.",
    "alarm_second_master": "Second master on the cable",
    "alarm_second_master_cause": "Responses came that Lineside had not requested: another program polls.",
    "alarm_second_master_consequence": "Requests collide, and another program may command the units.",
    "alarm_second_master_response": "Find the other program or panel and disconnect it from the cable.",
    "alarm_wire_overloaded": "Scan too slow",
    "alarm_wire_overloaded_cause": (
        "Retries, slow units or other requests take the time of the cable, or too many units share it."
    ),
    "alarm_wire_overloaded_consequence": "Values are old when they are shown; alarms come late.",
    "alarm_wire_overloaded_response": (
        "Look at page Bus for units with timeouts. Stop scripts that read parameters, or divide the cable."
    ),
    "alarm_control_left": "Control not released",
    "alarm_control_left_cause": "The holder of control has no page open and sends no commands.",
    "alarm_control_left_consequence": "Until control lapses, no other person can command the line.",
    "alarm_control_left_response": "Call the holder, or have an administrator hand control over.",
    "alarm_control_left_by": "held by {who}",
    "alarm_clock_stepped": "Clock of the server was set",
    "alarm_clock_stepped_cause": "A person set the clock, or its synchronization was interrupted before.",
    "alarm_clock_stepped_consequence": (
        "Times of events, alarms and history before and after it do not match; some overlap or are missing."
    ),
    "alarm_clock_stepped_response": "Check the time synchronization of the server. Write the step down.",
    "alarm_clock_step": "set by {seconds} s",
    "alarm_certificate_expiring": "Certificate expires",
    "alarm_certificate_expiring_cause": "A certificate that the configuration names ends within 30 days.",
    "alarm_certificate_expiring_consequence": "Then no e-mail or webhook that relies on it is sent.",
    "alarm_certificate_expiring_response": "Get the new certificate of the authority, and replace the file.",
    "alarm_token_expiring": "Token expires",
    "alarm_token_expiring_cause": "A token that a program uses ends soon, or has ended.",
    "alarm_token_expiring_consequence": "The program, or the bus worker, is then refused.",
    "alarm_token_expiring_response": "Create a token on page Users for the program, and revoke this one.",
    "alarm_expires": "{name} until {day}",
    "alarm_history_degraded": "History is not stored",
    "alarm_history_degraded_cause": "The disk is full, or the store cannot be used.",
    "alarm_history_degraded_consequence": "Trends of this time will be missing for good.",
    "alarm_history_degraded_response": "Free space on the disk, or have the store repaired.",
    "alarm_audit_degraded": "Audit log is not anchored",
    "alarm_audit_degraded_cause": "The anchor file cannot be written, or the log was altered.",
    "alarm_audit_degraded_consequence": "It cannot be shown later that the log is complete.",
    "alarm_audit_degraded_response": "Run 'lineside audit verify' and check the medium of the anchor.",
    "alarm_disk_low": "Disk nearly full",
    "alarm_disk_low_cause": "The disk of the server has little space left.",
    "alarm_disk_low_consequence": "The oldest readings are deleted, then none are stored.",
    "alarm_disk_low_response": "Free space on the disk in this shift.",
    "alarm_span_too_long": "at most {days} days at once",
    "alarm_figure_annunciated": "Alarms",
    "alarm_figure_per_day": "Alarms a day",
    "alarm_figure_per_10_minutes": "Alarms in 10 minutes, average",
    "alarm_figure_peak_10_minutes": "Alarms in 10 minutes, peak",
    "alarm_figure_windows_over_10": "Time with more than 10 alarms in 10 minutes",
    "alarm_figure_flood_share": "Time in flood",
    "alarm_figure_top_ten_share": "Share of the ten most frequent",
    "alarm_figure_chattering": "Chattering alarms (three times in a minute)",
    "alarm_figure_fleeting": "Fleeting alarms (cleared within 10 s)",
    "alarm_figure_stale": "Stale alarms (active for more than 24 h)",
    "alarm_figure_standing": "Active now",
    "alarm_figure_shelved": "Shelved now",
    "alarm_figure_suppressed": "Suppressed by design now",
    "alarm_figure_out_of_service": "Out of service now",
    "alarm_figure_urgent_share": "Share of priority urgent",
    "alarm_figure_high_share": "Share of priority high",
    "alarm_figure_medium_share": "Share of priority medium",
    "alarm_figure_low_share": "Share of priority low",
    "alarm_figure_acknowledge_median_s": "Time to acknowledge, median",
    "alarm_notification_failed": "Notification fails",
    "alarm_notification_failed_cause": (
        "The mail server or the receiver of a webhook refuses, does not respond, or cannot be reached."
    ),
    "alarm_notification_failed_consequence": "People who are away from the screen do not learn of alarms.",
    "alarm_notification_failed_response": "Watch the alarms here, and repair what page Notification names.",
    "alarm_own_text": "{text}",
    "alarm_own_without_text": "The configuration names none.",
    "alarm_state_normal": "normal",
    "alarm_silenced": "silenced",
    "alarm_state_unack_active": "active, not acknowledged",
    "alarm_state_ack_active": "active, acknowledged",
    "alarm_state_rtn_unack": "cleared, not acknowledged",
    "alarm_state_latched_unack": "latched, not acknowledged",
    "alarm_state_latched_ack": "latched, acknowledged",
    "alarm_state_shelved": "shelved",
    "alarm_state_suppressed": "suppressed by design",
    "alarm_state_out_of_service": "out of service",
    "alarm_superseded": (
        "{name} has come again since. Nothing was changed. Look at the new occurrence and acknowledge that."
    ),
    "alarm_unknown": "there is no alarm '{id}'",
    "alarm_not_in_state": "{name} is {state} by now. Nothing was changed.",
    "own_alarm_taken": "bus {bus} has an alarm {name} already; nothing was changed. Choose another name.",
    "own_alarms_full": (
        "{n} alarms of the site were added, the most there can be; nothing was changed. Remove one first."
    ),
    "own_alarm_key_of_other": (
        "the key of this request added another alarm; nothing was changed. Send a new one."
    ),
    "own_alarm_other_place": (
        "the name and the unit of {name} stay; nothing was changed. Remove it and add another one."
    ),
    "own_alarm_superseded": (
        "{name} has been changed since. Nothing was changed. Look at it as it is now, and change that."
    ),
    "own_alarm_configured": "{name} is in lineside.toml; nothing was changed. Change it there.",
    "own_alarm_unreadable": "what is stored is not an alarm; remove it and add it again",
    "alarm_needs_reason": "a reason is missing; nothing was changed",
    "event_alarm_acknowledged": "Alarm acknowledged: {name}",
    "event_alarm_silenced": "Alarm silenced: {name}",
    "event_alarms_silenced": Plural("{n} alarm silenced", "{n} alarms silenced"),
    "event_alarm_reset": "Alarm reset: {name}",
    "event_alarm_shelved": "Alarm shelved: {name}",
    "event_alarm_unshelved": "Alarm unshelved: {name}",
    "event_alarm_removed": "Alarm taken out of service: {name}",
    "event_alarm_returned": "Alarm returned to service: {name}",
    "event_own_alarm_added": "Alarm added: {name}",
    "event_own_alarm_changed": "Alarm changed: {name}",
    "event_own_alarm_removed": "Alarm removed: {name}",
}
