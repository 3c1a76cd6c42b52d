"""What needs a person's response: alarms as ISA-18.2-2016 (IEC 62682) describes them."""
