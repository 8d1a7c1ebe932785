#include "coordinator/journal/sqlite_journal.h"

#include <sqlite3.h>

#include <cstring>
#include <span>
#include <string_view>
#include <utility>

#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

constexpr std::int64_t schema_version = 3;

// `place` is the order of submission. Requests are kept apart from what changes, so that a change rewrites a short row.
constexpr const char* schema = R"(
CREATE TABLE meta(starts INTEGER NOT NULL);
INSERT INTO meta VALUES(0);
CREATE TABLE jobs(place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL, message BLOB NOT NULL,
                  submitted REAL NOT NULL, ended REAL NOT NULL, worker_seconds REAL NOT NULL, rays INTEGER NOT NULL);
CREATE TABLE requests(id TEXT PRIMARY KEY, request BLOB NOT NULL, frames BLOB NOT NULL);
CREATE TABLE frames_over(job TEXT NOT NULL, frame INTEGER NOT NULL, failure BLOB NOT NULL, PRIMARY KEY(job, frame))
                         WITHOUT ROWID;
CREATE TABLE ranges(job TEXT NOT NULL, artifact TEXT NOT NULL, first INTEGER NOT NULL, count INTEGER NOT NULL,
                    place INTEGER NOT NULL, bytes INTEGER NOT NULL, digest BLOB NOT NULL, facts BLOB NOT NULL,
                    frame INTEGER NOT NULL);
CREATE INDEX ranges_of_frame ON ranges(job, frame, artifact);
PRAGMA user_version = 3;
)";

// Layout 1 knew that a job's first `frames_done` frames were written, and ranges of the one after them alone.
constexpr const char* from_layout_1 = R"(
CREATE TABLE frames_over(job TEXT NOT NULL, frame INTEGER NOT NULL, failure BLOB NOT NULL, PRIMARY KEY(job, frame))
                         WITHOUT ROWID;
WITH RECURSIVE written(job, frame) AS (SELECT id, frames_done - 1 FROM jobs WHERE frames_done > 0
                                       UNION ALL SELECT job, frame - 1 FROM written WHERE frame > 0)
INSERT INTO frames_over SELECT job, frame, '' FROM written;
ALTER TABLE ranges ADD COLUMN frame INTEGER NOT NULL DEFAULT 0;
UPDATE ranges SET frame = (SELECT frames_done FROM jobs WHERE jobs.id = ranges.job)
  WHERE job IN (SELECT id FROM jobs);
DROP INDEX ranges_of_job;
CREATE INDEX ranges_of_frame ON ranges(job, frame, artifact);
ALTER TABLE jobs DROP COLUMN frames_done;
PRAGMA user_version = 2;
)";

// Layout 2 did not know what jobs had cost.
constexpr const char* from_layout_2 = R"(
ALTER TABLE jobs ADD COLUMN worker_seconds REAL NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN rays INTEGER NOT NULL DEFAULT 0;
PRAGMA user_version = 3;
)";

// What a person can do about it.
std::string advice(int code) {
  switch (code & 0xff) {
    case SQLITE_FULL:
      return "the disk is full";
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return "another process holds it locked";
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
      return "it is damaged; put a copy in its place, or move it away to begin without the jobs that it knows "
             "(pictures stay)";
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return "it must not be written";
    case SQLITE_CANTOPEN:
      return "it cannot be opened";
    default:
      return {};
  }
}

class SqliteJournal;

// One statement that was prepared; values are bound in the order of their question marks.
class Statement {
 public:
  Statement(SqliteJournal& journal, const char* text);
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  Statement& bind(std::string_view text) {
    sqlite3_bind_text(statement_, ++bound_, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT);
    return *this;
  }
  Statement& bind(std::span<const std::byte> bytes) {
    // A null pointer would bind NULL.
    sqlite3_bind_blob64(statement_, ++bound_, bytes.empty() ? "" : static_cast<const void*>(bytes.data()), bytes.size(),
                        SQLITE_TRANSIENT);
    return *this;
  }
  Statement& bind_bytes(const std::string& bytes) { return bind(std::as_bytes(std::span(bytes))); }
  Statement& bind(std::uint64_t number) {
    sqlite3_bind_int64(statement_, ++bound_, static_cast<sqlite3_int64>(number));
    return *this;
  }
  Statement& bind(double number) {
    sqlite3_bind_double(statement_, ++bound_, number);
    return *this;
  }

  bool step();  // false: there is no further row
  void run() {  // a statement without rows; it can be bound anew
    step();
    sqlite3_reset(statement_);
    bound_ = 0;
  }

  std::string text(int column) const {
    const auto size = static_cast<std::size_t>(sqlite3_column_bytes(statement_, column));
    const void* at = sqlite3_column_blob(statement_, column);
    return at ? std::string(static_cast<const char*>(at), size) : std::string();
  }
  Bytes bytes(int column) const {
    const auto size = static_cast<std::size_t>(sqlite3_column_bytes(statement_, column));
    const auto* at = static_cast<const std::byte*>(sqlite3_column_blob(statement_, column));
    return at ? Bytes(at, at + size) : Bytes();
  }
  std::uint64_t number(int column) const {
    return static_cast<std::uint64_t>(sqlite3_column_int64(statement_, column));
  }
  double real(int column) const { return sqlite3_column_double(statement_, column); }

 private:
  SqliteJournal& journal_;
  sqlite3_stmt* statement_ = nullptr;
  int bound_ = 0;
};

class SqliteJournal final : public Journal {
 public:
  SqliteJournal(const fs::path& file, double patience) : name_(printable(file.string())) {
    const int code = sqlite3_open_v2(file.c_str(), &database_,
                                     SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, nullptr);
    try {
      check(code);
      sqlite3_extended_result_codes(database_, 1);
      sqlite3_busy_timeout(database_, static_cast<int>(patience * 1000));
      open();
    } catch (...) {
      sqlite3_close(database_);
      throw;
    }
  }
  ~SqliteJournal() override { sqlite3_close(database_); }

  std::string name() const override { return name_; }

  std::uint64_t begin() override {
    execute("UPDATE meta SET starts = starts + 1");
    Statement starts(*this, "SELECT starts FROM meta");
    return starts.step() ? starts.number(0) & 0xffffffff : 0;
  }

  std::vector<JournalJob> jobs() override {
    Statement rows(*this,
                   "SELECT jobs.id, state, message, submitted, ended, worker_seconds, rays, request FROM jobs "
                   "LEFT JOIN requests ON requests.id = jobs.id ORDER BY place");
    std::vector<JournalJob> all;
    while (rows.step())
      all.push_back({.id = rows.text(0),
                     .state = rows.text(1),
                     .message = rows.text(2),
                     .submitted = rows.real(3),
                     .ended = rows.real(4),
                     .worker_seconds = rows.real(5),
                     .rays = rows.number(6),
                     .request = rows.bytes(7)});
    return all;
  }

  Bytes frames(const std::string& job) override {
    Statement rows(*this, "SELECT frames FROM requests WHERE id = ?");
    rows.bind(job);
    return rows.step() ? rows.bytes(0) : Bytes();
  }

  std::vector<JournalFrame> frames_over(const std::string& job) override {
    Statement rows(*this, "SELECT frame, failure FROM frames_over WHERE job = ? ORDER BY frame");
    rows.bind(job);
    std::vector<JournalFrame> all;
    while (rows.step()) all.push_back({.job = job, .frame = rows.number(0), .failure = rows.text(1)});
    return all;
  }

  std::vector<JournalRange> ranges(const std::string& job, std::uint64_t frame) override {
    Statement rows(*this,
                   "SELECT artifact, first, count, place, bytes, digest, facts FROM ranges WHERE job = ? AND frame = ? "
                   "ORDER BY artifact, first");
    rows.bind(job).bind(frame);
    std::vector<JournalRange> all;
    while (rows.step())
      all.push_back({.job = job,
                     .frame = frame,
                     .artifact = rows.text(0),
                     .first = rows.number(1),
                     .count = rows.number(2),
                     .offset = rows.number(3),
                     .bytes = rows.number(4),
                     .digest = rows.text(5),
                     .facts = rows.bytes(6)});
    return all;
  }

  void add(const JournalJob& job, const Bytes& frames) override {
    transaction([&] {
      Statement(*this,
                "INSERT INTO jobs(id, state, message, submitted, ended, worker_seconds, rays) "
                "VALUES(?, ?, ?, ?, ?, ?, ?)")
          .bind(job.id)
          .bind(job.state)
          .bind_bytes(job.message)
          .bind(job.submitted)
          .bind(job.ended)
          .bind(job.worker_seconds)
          .bind(job.rays)
          .run();
      Statement(*this, "INSERT INTO requests(id, request, frames) VALUES(?, ?, ?)")
          .bind(job.id)
          .bind(std::span<const std::byte>(job.request))
          .bind(std::span<const std::byte>(frames))
          .run();
    });
  }

  void write(const JournalChanges& changes) override {
    transaction([&] {
      write_frames(changes);
      write_ranges(changes);
      write_jobs(changes);  // takes out what was forgotten
    });
  }

  void check(int code) {
    if (code == SQLITE_OK || code == SQLITE_ROW || code == SQLITE_DONE) return;
    const std::string reason = database_ ? sqlite3_errmsg(database_) : sqlite3_errstr(code), help = advice(code);
    throw Error::failed("journal " + name_ + ": " + (help.empty() ? reason : help + " (" + reason + ")"));
  }

  sqlite3* database() { return database_; }

 private:
  void open() {
    execute("PRAGMA journal_mode = WAL");
    // A job whose id was told must not be lost with the power.
    execute("PRAGMA synchronous = FULL");
    check_integrity();
    std::int64_t version = 0;
    {
      Statement row(*this, "PRAGMA user_version");
      if (row.step()) version = static_cast<std::int64_t>(row.number(0));
    }
    if (version > schema_version)
      throw Error::failed("journal " + name_ + ": it was written by a newer version of Gleaner (layout " +
                          std::to_string(version) + ", this one knows " + std::to_string(schema_version) + ")");
    if (version == 0) transaction([&] { execute(schema); });
    if (version == 1) transaction([&] { execute(from_layout_1); });
    if (version == 1 || version == 2) transaction([&] { execute(from_layout_2); });
  }

  void check_integrity() {
    Statement rows(*this, "PRAGMA integrity_check(1)");
    if (rows.step() && rows.text(0) != "ok")
      throw Error::failed("journal " + name_ + ": " + advice(SQLITE_CORRUPT) + " (" + rows.text(0) + ")");
  }

  void write_jobs(const JournalChanges& changes) {
    Statement update(*this,
                     "UPDATE jobs SET state = ?, message = ?, ended = ?, worker_seconds = ?, rays = ? WHERE id = ?");
    for (const auto& [id, job] : changes.jobs)
      update.bind(job.state)
          .bind_bytes(job.message)
          .bind(job.ended)
          .bind(job.worker_seconds)
          .bind(job.rays)
          .bind(id)
          .run();
    for (const std::string& id : changes.forgotten)
      for (const char* text : {"DELETE FROM jobs WHERE id = ?", "DELETE FROM requests WHERE id = ?",
                               "DELETE FROM frames_over WHERE job = ?", "DELETE FROM ranges WHERE job = ?"})
        Statement(*this, text).bind(id).run();
  }

  void write_frames(const JournalChanges& changes) {
    for (const std::string& job : changes.retried)
      Statement(*this, "DELETE FROM frames_over WHERE job = ? AND length(failure) > 0").bind(job).run();
    Statement insert(*this, "INSERT OR REPLACE INTO frames_over(job, frame, failure) VALUES(?, ?, ?)");
    for (const JournalFrame& frame : changes.frames_over)
      insert.bind(frame.job).bind(frame.frame).bind_bytes(frame.failure).run();
  }

  void write_ranges(const JournalChanges& changes) {
    Statement drop(*this, "DELETE FROM ranges WHERE job = ? AND frame = ?");
    for (const auto& [job, frame] : changes.dropped_frames) drop.bind(job).bind(frame).run();
    for (const std::string& job : changes.dropped_jobs)
      Statement(*this, "DELETE FROM ranges WHERE job = ?").bind(job).run();
    Statement insert(*this,
                     "INSERT INTO ranges(job, frame, artifact, first, count, place, bytes, digest, facts) "
                     "VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)");
    for (const JournalRange& range : changes.ranges)
      insert.bind(range.job)
          .bind(range.frame)
          .bind(range.artifact)
          .bind(range.first)
          .bind(range.count)
          .bind(range.offset)
          .bind(range.bytes)
          .bind_bytes(range.digest)
          .bind(std::span<const std::byte>(range.facts))
          .run();
  }

  void execute(const char* text) { check(sqlite3_exec(database_, text, nullptr, nullptr, nullptr)); }

  template <typename Call>
  void transaction(const Call& call) {
    execute("BEGIN IMMEDIATE");
    try {
      call();
      execute("COMMIT");
    } catch (...) {
      // It may have been rolled back by what failed.
      sqlite3_exec(database_, "ROLLBACK", nullptr, nullptr, nullptr);
      throw;
    }
  }

  std::string name_;
  sqlite3* database_ = nullptr;
};

Statement::Statement(SqliteJournal& journal, const char* text) : journal_(journal) {
  journal_.check(sqlite3_prepare_v2(journal.database(), text, -1, &statement_, nullptr));
}

bool Statement::step() {
  const int code = sqlite3_step(statement_);
  journal_.check(code);
  return code == SQLITE_ROW;
}

}  // namespace

std::unique_ptr<Journal> open_sqlite_journal(const fs::path& file, double patience) {
  return std::make_unique<SqliteJournal>(file, patience);
}

}  // namespace gleaner::coordinator
