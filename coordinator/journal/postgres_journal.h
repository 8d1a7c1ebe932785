#pragma once
// The journal in a PostgreSQL database, for coordinators whose own disk is not to be trusted with it.

#include <memory>
#include <string>

#include "coordinator/journal/journal.h"

namespace gleaner::coordinator {

// `address`: postgresql://USER@HOST:PORT/DATABASE, or whatever libpq takes. Makes the schema "gleaner" where there is
// none. One coordinator at a time has it: one that has died is waited for, as one whose server is away, up to
// `patience` seconds. A connection that is lost later is made again by the next call. Throws Error::failed, naming the
// server, where it cannot be used; the address's password is in no message.
std::unique_ptr<Journal> open_postgres_journal(const std::string& address, double patience = 5);

}  // namespace gleaner::coordinator
