-- A site is one server: which of several had a bus is read by nobody any more. The audit log keeps its events.
DROP TABLE home;
DROP TABLE home_epoch;
