"""Texts of notification: what people are sent, why it was not delivered, and what is recorded."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "notify_subject_alarm": "{priority}: {place} · {name}",
    "notify_subject_escalated": "Not acknowledged, {priority}: {place} · {name}",
    "notify_subject_clear": "Cleared: {place} · {name}",
    "notify_subject_digest": "{site}: {n} messages, {urgent} of them urgent",
    "notify_subject_heartbeat": "{site}: notification works",
    "notify_subject_test": "{site}: test of notification",
    "notify_body_heartbeat": (
        "Alarms of {site} reach this address. This message comes every day; report it when it does not come."
    ),
    "notify_body_test": "A user of {site} has sent this message to test the path. Nothing needs to be done.",
    "notify_line_alarm": "Since {time}",
    "notify_line_clear": "Its condition has ended: {time}",
    "notify_line_cause": "Cause: {text}",
    "notify_line_response": "Response: {text}",
    "notify_line_link": "Acknowledge (needs a login): {link}",
    "notify_footer": "-- \n{site}, Lineside. Message {id}",
    "notify_several": "{n} messages",
    "notify_kind_alarm": "{name}",
    "notify_kind_clear": "cleared: {name}",
    "notify_kind_heartbeat": "daily heartbeat",
    "notify_kind_test": "test",
    "event_notification_delivered": "Notification delivered to {to}: {subject}",
    "event_notification_retrying": "Notification not delivered to {to}, it is tried again: {subject}",
    "event_notification_failed": "Notification given up for {to}: {subject}",
    "event_maintenance_begun": Plural(
        "Notification paused for maintenance: {n} minute", "Notification paused for maintenance: {n} minutes"
    ),
    "event_maintenance_ended": "Notification resumed, maintenance ended",
    "maintenance_not_present": "This maintenance has ended by now. Nothing was changed.",
    "maintenance_needs_reason": "Give a reason. Nothing was changed.",
    "notify_roster_gap": (
        "Group {group}: no one is on duty from {first_day} {first} to {last_day} {last}. "
        "In this time all of the group are notified."
    ),
    "day_0": "Monday",
    "day_1": "Tuesday",
    "day_2": "Wednesday",
    "day_3": "Thursday",
    "day_4": "Friday",
    "day_5": "Saturday",
    "day_6": "Sunday",
    "notify_endpoint_unknown": "there is no address '{endpoint}' in the configuration of notification",
    "notify_link_invalid": "This link is not valid. Open the page Alarms and acknowledge the alarm there.",
    "notify_link_expired": (
        "This link has expired. Open the page Alarms and acknowledge the alarm there, if it is still present."
    ),
    "notify_address_removed": "The address is not in the configuration any more.",
    "notify_secret_unreadable": "{path} cannot be read: {reason}. Give the file to the user of Lineside.",
    "notify_secret_empty": "{path} holds no secret of 1 to {n} bytes. Write it into the file, on one line.",
    "notify_secret_not_text": "{path} does not hold one line of ASCII characters. Write it again.",
    "notify_secret_not_url": "{path} holds no URL of http or https without a password. Write it again.",
    "notify_password_missing": (
        "The mail server needs a password. Name its file in password_file, or set {variable}."
    ),
    "notify_certificate_untrusted": (
        "The certificate of {host}:{port} is not trusted: {reason}. Name its authority in ca_file."
    ),
    "notify_tls_failed": "No encrypted connection to {host}:{port}: {reason}. Check port and security.",
    "notify_mail_without_tls": (
        "Mail server {host}:{port} offers no encryption (STARTTLS). Nothing was sent. Check the port."
    ),
    "notify_mail_without_sign_in": (
        "Mail server {host}:{port} takes no user and password. Remove user, or check the port."
    ),
    "notify_mail_sign_in_refused": (
        "Mail server {host}:{port} refused user or password: {reason}. Check both."
    ),
    "notify_mail_refused": "Mail server {host}:{port} refused: {reason}. Check sender and recipient.",
    "notify_timed_out": "{host}:{port} did not respond in time. Check whether it is up and reachable.",
    "notify_took_too_long": "No result after {seconds} s. Check whether the receiver is up and responds.",
    "notify_disconnected": "{host}:{port} closed the connection. Check its log.",
    "notify_host_unknown": "There is no host {host}. Check the name and the name server.",
    "notify_not_connected": "No connection to {host}:{port}: {reason}. Check address, port and network.",
    "notify_redirected": (
        "{host}:{port} redirects to another address ({status}), which is not followed. Configure that."
    ),
    "notify_http_refused": "{host}:{port} refused with status {status}. Check the URL and its log.",
    "notify_apprise_missing": (
        "The package apprise is not installed. Install the extra: pip install lineside[apprise]"
    ),
    "notify_apprise_url": "{path} holds no URL that apprise knows. Check it by its documentation.",
    "notify_apprise_refused": "The service of {name} did not take the message. Check its URL.",
    "notify_failed_unexpectedly": "Sending failed: {error}. Report it with the log of the server.",
    "check_notify_mail": "mail server {address} responds",
    "check_notify_webhook": "webhook {address} responds",
    "check_notify_apprise": "apprise knows the URL of {address}",
    "check_notify_failed": "notification by {address}: {reason}",
    "check_notify_no_links": (
        "notify.dashboard_url is not set: messages of alarms have no link to acknowledge them"
    ),
    "check_secret_open": "{path} can be read by every user of this machine: run chmod o= {path}",
}
