"""Texts about users, tokens, passwords and PINs."""

TEXTS = {
    "holder_signed_out": "logged out, or rights changed",
    "unknown_name": "unknown name",
    "unknown_token": "unknown token",
    "many_addresses": "several addresses",
    "command_line": "command line",
    "account_of_token": "{name} (token)",
    "token_exists": "a token {name} exists already; revoke it or choose another name",
    "no_such_token": "there is no token {name}",
    "user_exists": "a user {name} exists already; choose another name",
    "no_such_user": "there is no user {name}",
    "last_admin": "{name} is the last admin; give another user the role admin first",
    "panel_pin_by_admin": "only an admin can change the PIN of a panel",
    "new_passwords_differ": "the two new passwords differ; nothing was changed",
    "no_account": "only a logged-in user has an account",
    "no_such_language": "there is no language '{language}'",
    "name_looks_like": "the name '{name}' looks like '{other}', which exists already; choose another name",
    "name_not_allowed": (
        "the name '{name}' is not allowed; "
        "write 1 to 40 letters, digits, . _ @ or -, letters of the Latin script"
    ),
    "panel_role_too_high": ("a panel is an operator at most; the role {role} is for users with a password"),
    "token_not_for_bus": "a token with the role {role} has no bus; leave the bus out",
    "worker_token_needs_bus": "a token with the role worker is for one bus; give one of {known}",
    "token_days_out_of_range": "a token expires after 1 to {most} days; {days} is out of range",
    "home_page_elsewhere": "a home page is a path on this server, such as / or /units/dry-end/1",
    "present_password_wrong": "wrong current password; nothing was changed",
    "too_many_sign_ins": "too many failed logins; try again in {seconds} s",
    "panel_with_higher_role": (
        "the panel {called} has the role {role}; a panel is an operator at most; an admin can change it"
    ),
    "password_length": "a password has {least} to {most} characters; this one has {count}",
    "password_contains_user": "the password contains the user name; choose another",
    "password_contains_site": "the password contains the name of the site; choose another",
    "password_easy_to_guess": (
        "the password is easy to guess (common words, repetition, sequences, key runs); choose another"
    ),
    "pin_length": "a PIN is 6 to 12 digits",
    "pin_easy_to_guess": "the PIN is easy to guess (repetition, sequence, key run or date); choose another",
    "token_days_malformed": "the days until a token expires are an integer, or empty",
    "worker_token_without_bus": (
        "the token {called} has no bus; an admin can create one with --role worker --bus BUS"
    ),
    "no_such_role": "there is no role '{role}'; choose one of {known}",
    "role_needed": "this needs the role {role}; {name} has the role {present}",
    "rights_user_ended": "rights withdrawn: the user was removed or disabled; nothing more was sent",
    "rights_token_ended": "rights withdrawn: the token was revoked or has expired; nothing more was sent",
    "rights_password_changed": "rights withdrawn: the password was changed; nothing more was sent",
    "rights_role_lowered": "rights withdrawn: the role was lowered; nothing more was sent",
    "name_or_password_wrong": "wrong name or password",
    "name_or_pin_wrong": "wrong name or PIN",
    "token_expired": "the token {called} expired on {day}; an admin can create a new one",
    "sign_in_needed": "log in, or send a valid token",
}
