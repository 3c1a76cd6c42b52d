"""Alarms: conditions that need a person's response, as ISA-18.2-2016 (IEC 62682) describes them."""
