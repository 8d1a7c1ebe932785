// Who may do what: the farm's own authority, TLS with certificates on both sides, roles, revoked certificates.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <jwt.h>

#include <fstream>
#include <map>
#include <thread>

#include "proto/authority.h"
#include "proto/openssl_handles.h"
#include "proto/token.h"
#include "tests/farm/raw_call.h"
#include "tests/farm/wire_farm.h"
#include "worker/agent/part_server.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using grpc::StatusCode;
using testing::HasSubstr;
using testing::SizeIs;

class Keyring : public testing::Test {
 protected:
  fs::path issue(const std::string& name, const std::set<Role>& roles, int days = 30) {
    authority_.issue(name, roles, days, path(name));
    return path(name);
  }
  Keys token(const std::string& name, const std::set<Role>& roles, int days = 30) {
    authority_.issue_token(name, roles, days, path(name));
    return load_keys(path(name));
  }
  fs::path path(const std::string& name) const { return folder_.path() / name; }
  Keys own(Role role) {
    const std::string name = role_name(role);
    return load_keys(fs::exists(path(name)) ? path(name) : issue(name, {role}));
  }
  std::shared_ptr<const Keys> coordinator() const {
    return std::make_shared<const Keys>(load_keys(path("farm") / "coordinator"));
  }
  static std::shared_ptr<grpc::Channel> dial(const std::string& address, const Keys* keys,
                                             Role expected = Role::coordinate) {
    grpc::ChannelArguments arguments;
    arguments.SetInt("grpc.use_local_subchannel_pool", 1);
    const auto credentials = channel_credentials(keys, expected, arguments);
    return grpc::CreateCustomChannel(address, credentials, arguments);
  }
  // For the caller's certificate, and not for what it asked.
  static bool refused_at_the_door(const grpc::Status& status) {
    EXPECT_NE(status.error_code(), StatusCode::UNAVAILABLE) << status.error_message();
    return status.error_code() == StatusCode::UNAUTHENTICATED ||
           (status.error_code() == StatusCode::PERMISSION_DENIED &&
            status.error_message().find("with what it shows") != std::string::npos);
  }
  static StatusCode list_jobs(const std::string& address, const Keys* keys) {
    return raw_call(dial(address, keys), "/gleaner.v1.Farm/ListJobs").error_code();
  }
  static std::string complaint(const fs::path& folder) {
    try {
      load_keys(folder);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "none";
  }

  TemporaryFolder folder_;
  Authority authority_ = Authority::init(path("farm"), 100);
};

TEST_F(Keyring, WhatIsIssuedIsOnRecord) {
  issue("anna", {Role::submit, Role::work});
  const auto issued = authority_.issued();
  ASSERT_THAT(issued, SizeIs(2));
  EXPECT_EQ(issued[0].name, "coordinator");
  EXPECT_EQ(issued[1].name, "anna");
  EXPECT_EQ(issued[1].roles, (std::set<Role>{Role::submit, Role::work}));
  EXPECT_FALSE(issued[1].revoked);
  EXPECT_EQ(authority_.revoke("anna"), 1);
  EXPECT_TRUE(authority_.issued()[1].revoked);
  EXPECT_THROW(authority_.revoke("anna"), Error) << "nothing is left to revoke";
  for (const fs::path& key : {path("farm") / "authority.key", path("anna") / key_file})
    EXPECT_EQ(fs::status(key).permissions(), fs::perms::owner_read | fs::perms::owner_write) << key;
}

TEST_F(Keyring, BadWordsAreRefused) {
  for (const char* name : {"", "../up", "a b", "\xff", ".hidden"})
    EXPECT_THROW(authority_.issue(name, {Role::work}, 1, path("x")), Error) << name;
  EXPECT_THROW(authority_.issue("nobody", {}, 1, path("x")), Error);
  EXPECT_THROW(authority_.issue("longer", {Role::work}, 101, path("x")), Error) << "than the authority lasts";
  issue("there", {Role::work});
  EXPECT_THROW(issue("there", {Role::work}), Error);
  EXPECT_THROW(Authority::init(path("farm"), 1), Error);
  EXPECT_THROW(Authority(path("nowhere")), Error);
  EXPECT_THROW(parse_role("king"), Error);
}

TEST_F(Keyring, FoldersOfKeysAreChecked) {
  Authority::init(path("others"), 100).issue("eve", {Role::work}, 30, path("eve"));
  EXPECT_THAT(complaint(path("nowhere")), HasSubstr("authority.crt"));
  const fs::path mixed = issue("mixed", {Role::work});
  fs::copy_file(path("eve") / key_file, mixed / key_file, fs::copy_options::overwrite_existing);
  EXPECT_THAT(complaint(mixed), HasSubstr("own.key"));
  fs::copy_file(path("eve") / certificate_file, mixed / certificate_file, fs::copy_options::overwrite_existing);
  EXPECT_THAT(complaint(mixed), HasSubstr("by the authority"));
  std::ofstream(mixed / certificate_file) << "no certificate";
  EXPECT_THAT(complaint(mixed), HasSubstr("own.crt: expected a certificate (PEM)"));
  EXPECT_THAT(complaint(issue("old", {Role::work}, 0)), HasSubstr("expired"));
}

// A call that this table does not know fails the test: somebody must have thought about who may make it.
TEST_F(Keyring, EachCallAsksForItsRole) {
  const std::map<std::string, Role> needed = {
      {"Farm/MissingBlobs", Role::submit}, {"Farm/UploadBlob", Role::submit},
      {"Farm/SubmitJob", Role::submit},    {"Farm/CancelJob", Role::submit},
      {"Farm/PauseJob", Role::submit},     {"Farm/RetryJob", Role::submit},
      {"Farm/Session", Role::submit},      {"Farm/DrainWorker", Role::administer},
      {"Farm/ListJobs", Role::observe},    {"Farm/GetJob", Role::observe},
      {"Farm/WatchJob", Role::observe},    {"Farm/WatchEvents", Role::observe},
      {"Farm/GetPreview", Role::observe},  {"Farm/Why", Role::observe},
      {"Farm/ListFiles", Role::observe},   {"Farm/FetchFile", Role::observe},
      {"Farm/ListWorkers", Role::observe}, {"WorkerHub/Work", Role::work},
      {"WorkerHub/FetchBlob", Role::work}, {"WorkerHub/LocateArtifact", Role::work},
      {"WorkerHub/FetchPart", Role::work}, {"WorkerHub/DeliverPart", Role::work}};
  const std::map<Role, std::set<Role>> allowed = {{Role::coordinate, {Role::observe}},
                                                  {Role::work, {Role::work}},
                                                  {Role::observe, {Role::observe}},
                                                  {Role::submit, {Role::observe, Role::submit}},
                                                  {Role::administer, {Role::observe, Role::submit, Role::administer}}};
  WireFarm farm(64 << 20, 16, 30, coordinator());
  for (const auto& [role, may] : allowed) {
    const Keys keys = own(role);
    const auto channel = dial(farm.server().address(), &keys);
    for (const char* service : {"gleaner.v1.Farm", "gleaner.v1.WorkerHub"}) {
      const auto* descriptor = google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(service);
      ASSERT_TRUE(descriptor);
      for (int i = 0; i < descriptor->method_count(); ++i) {
        const std::string name = descriptor->name() + "/" + descriptor->method(i)->name();
        ASSERT_TRUE(needed.contains(name)) << name << ": whose call is it?";
        const grpc::Status status = raw_call(channel, "/gleaner.v1." + name);
        EXPECT_EQ(refused_at_the_door(status), !may.contains(needed.at(name)))
            << name << " as " << role_name(role) << ": " << status.error_message();
      }
    }
    EXPECT_EQ(raw_call(channel, "/gleaner.v1.Farm/ThatIsYetToCome").error_code(),
              role == Role::administer ? StatusCode::UNIMPLEMENTED : StatusCode::PERMISSION_DENIED);
  }
}

TEST_F(Keyring, StrangersAreNotLetIn) {
  WireFarm farm(64 << 20, 16, 30, coordinator());
  const std::string& address = farm.server().address();
  const Keys friends = own(Role::observe);
  EXPECT_EQ(list_jobs(address, &friends), StatusCode::OK);
  EXPECT_EQ(list_jobs(address, nullptr), StatusCode::UNAVAILABLE) << "in the clear";
  Authority::init(path("others"), 100).issue("eve", {Role::administer}, 30, path("eve"));
  const Keys eve = load_keys(path("eve"));
  EXPECT_EQ(list_jobs(address, &eve), StatusCode::UNAVAILABLE) << "of another authority";
  // Of no authority that the client need say: TLS without a certificate.
  grpc::ChannelArguments arguments;
  arguments.SetSslTargetNameOverride(role_dns_name(Role::coordinate));
  const auto bare = grpc::CreateCustomChannel(address, grpc::SslCredentials({friends.authority, "", ""}), arguments);
  EXPECT_EQ(raw_call(bare, "/gleaner.v1.Farm/ListJobs").error_code(), StatusCode::UNAUTHENTICATED)
      << "without a certificate and without a token";
  EXPECT_EQ(list_jobs(address, &friends), StatusCode::OK);
}

TEST_F(Keyring, OnlyACoordinatorAnswersAsOne) {
  issue("worker", {Role::work});
  WireFarm impostor(64 << 20, 16, 30, std::make_shared<const Keys>(load_keys(path("worker"))));
  const Keys keys = own(Role::submit);
  EXPECT_EQ(list_jobs(impostor.server().address(), &keys), StatusCode::UNAVAILABLE);
}

TEST_F(Keyring, RevokedCertificatesAreRefusedAtOnce) {
  WireFarm farm(64 << 20, 16, 30, coordinator());
  const Keys anna = load_keys(issue("anna", {Role::submit})), otto = load_keys(issue("otto", {Role::observe}));
  const auto channel = dial(farm.server().address(), &anna);
  EXPECT_TRUE(raw_call(channel, "/gleaner.v1.Farm/ListJobs").ok());
  authority_.revoke("anna");
  EXPECT_EQ(raw_call(channel, "/gleaner.v1.Farm/ListJobs").error_code(), StatusCode::UNAUTHENTICATED)
      << "on a connection that is there";
  EXPECT_EQ(list_jobs(farm.server().address(), &otto), StatusCode::OK);
  authority_.revoke("otto");
  EXPECT_EQ(list_jobs(farm.server().address(), &otto), StatusCode::UNAUTHENTICATED);
}

TEST_F(Keyring, TokensLetPeopleIn) {
  WireFarm farm(64 << 20, 16, 30, coordinator());
  const std::string& address = farm.server().address();
  const auto status_of = [&](const Keys& keys, const char* method) { return raw_call(dial(address, &keys), method); };
  const Keys otto = token("otto", {Role::observe}), anna = token("anna", {Role::administer});
  EXPECT_TRUE(status_of(otto, "/gleaner.v1.Farm/ListJobs").ok());
  const grpc::Status refused = status_of(otto, "/gleaner.v1.Farm/SubmitJob");
  EXPECT_EQ(refused.error_code(), StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(refused.error_message(), HasSubstr("otto may not submit"));
  EXPECT_FALSE(refused_at_the_door(status_of(anna, "/gleaner.v1.Farm/SubmitJob")));
  EXPECT_FALSE(refused_at_the_door(status_of(anna, "/gleaner.v1.Farm/DrainWorker")));
  EXPECT_TRUE(refused_at_the_door(status_of(anna, "/gleaner.v1.WorkerHub/Work")));

  const auto issued = authority_.issued();
  EXPECT_TRUE(issued.back().token);
  EXPECT_FALSE(issued.front().token);
  EXPECT_EQ(authority_.revoke("otto"), 1);
  EXPECT_EQ(list_jobs(address, &otto), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(list_jobs(address, &anna), StatusCode::OK);
  EXPECT_EQ(fs::status(path("anna") / token_file).permissions(), fs::perms::owner_read | fs::perms::owner_write);
}

// One connection may carry calls of several people: what one of them shows is not the others'.
TEST_F(Keyring, ATokenCountsForItsCallAlone) {
  WireFarm farm(64 << 20, 16, 30, coordinator());
  const Keys anna = token("anna", {Role::observe});
  grpc::ChannelArguments arguments;
  arguments.SetSslTargetNameOverride(role_dns_name(Role::coordinate));
  const auto channel =
      grpc::CreateCustomChannel(farm.server().address(), grpc::SslCredentials({anna.authority, "", ""}), arguments);
  const auto list = [&](const std::string& shown) {
    grpc::ClientContext context;
    if (!shown.empty()) context.AddMetadata("authorization", shown);
    gleaner::v1::ListJobsReply reply;
    return gleaner::v1::Farm::NewStub(channel)->ListJobs(&context, {}, &reply).error_code();
  };
  EXPECT_EQ(list("Bearer " + anna.token), StatusCode::OK);
  EXPECT_EQ(list(""), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(list("Basic " + anna.token), StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(list("Bearer x" + anna.token), StatusCode::UNAUTHENTICATED);
}

TEST_F(Keyring, PartsOfTheFarmHaveNoTokens) {
  for (const Role role : {Role::work, Role::coordinate})
    EXPECT_THROW(authority_.issue_token("part", {role}, 1, path("part")), Error) << role_name(role);
  EXPECT_THROW(authority_.issue_token("longer", {Role::submit}, 101, path("longer")), Error) << "than the authority";
  const Keys anna = token("anna", {Role::submit});
  EXPECT_THROW(require_certificate(anna, "a worker"), Error);
  EXPECT_THROW(server_credentials(std::make_shared<const Keys>(anna), {}, Admits::tokens_too), Error);
  require_certificate(own(Role::work), "a worker");
}

class Tokens : public Keyring {
 protected:
  std::optional<Peer> read(const std::string& token) { return reader_.read(token); }
  static std::string text(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  // For an hour from now.
  static std::string claims(const std::string& role) {
    return R"({"sub":"eve","jti":"0A","exp":)" + std::to_string(std::time(nullptr) + 3600) + R"(,"roles":[")" + role +
           R"("]})";
  }
  static std::string forge(const std::string& claims, jwt_alg_t algorithm, const std::string& key) {
    jwt_t* token = nullptr;
    EXPECT_EQ(jwt_new(&token), 0);
    EXPECT_EQ(jwt_add_grants_json(token, claims.c_str()), 0);
    const auto* bytes = reinterpret_cast<const unsigned char*>(key.c_str());
    EXPECT_EQ(jwt_set_alg(token, algorithm, key.empty() ? nullptr : bytes, static_cast<int>(key.size())), 0);
    char* encoded = jwt_encode_str(token);
    EXPECT_NE(encoded, nullptr);
    const std::string copy = encoded ? encoded : "";
    std::free(encoded);
    jwt_free(token);
    return copy;
  }

  const std::string key_ = text(path("farm") / "authority.key");
  TokenReader reader_{text(path("farm") / authority_file)};
};

TEST_F(Tokens, SayWhoAndWhat) {
  const std::string good = forge(claims("submit"), JWT_ALG_ES256, key_);
  for (int i = 0; i < 2; ++i) {  // the second time it is known
    const std::optional<Peer> peer = read(good);
    ASSERT_TRUE(peer);
    EXPECT_EQ(peer->name, "eve");
    EXPECT_EQ(peer->serial, "0A");
    EXPECT_EQ(peer->roles, (std::set<Role>{Role::submit, Role::observe}));
  }
}

TEST_F(Tokens, ForgedOnesAreNone) {
  Authority::init(path("others"), 100);
  EXPECT_FALSE(read(forge(claims("submit"), JWT_ALG_ES256, text(path("others") / "authority.key"))));
  EXPECT_FALSE(read(forge(claims("submit"), JWT_ALG_NONE, "")));
  // The public key is known to all: as the secret of a symmetric signature it proves nothing.
  const openssl::Held<X509> certificate = openssl::parse_certificate(text(path("farm") / authority_file));
  const std::string public_key =
      openssl::pem_of([&](BIO* bio) { return PEM_write_bio_PUBKEY(bio, X509_get0_pubkey(certificate.get())); });
  EXPECT_FALSE(read(forge(claims("submit"), JWT_ALG_HS256, public_key)));

  std::string altered = forge(claims("observe"), JWT_ALG_ES256, key_);
  altered.replace(altered.find('.') + 10, 1, altered[altered.find('.') + 10] == 'A' ? "B" : "A");
  EXPECT_FALSE(read(altered));
  for (const std::string& nothing : {std::string(), std::string("."), std::string(".."), std::string(1 << 20, 'a')})
    EXPECT_FALSE(read(nothing));
}

TEST_F(Tokens, SignedForSomethingElseTheyAreNone) {
  EXPECT_FALSE(read(forge(claims("work"), JWT_ALG_ES256, key_)));
  EXPECT_FALSE(read(forge(claims("coordinate"), JWT_ALG_ES256, key_)));
  EXPECT_FALSE(read(forge(claims("king"), JWT_ALG_ES256, key_)));
  for (const char* odd : {R"({"sub":"eve"})", R"({"sub":1,"jti":"0A","exp":99999999999,"roles":["submit"]})",
                          R"({"sub":"eve","jti":"0A","exp":"soon","roles":["submit"]})",
                          R"({"sub":"eve","jti":"0A","exp":1,"roles":["submit"]})",
                          R"({"sub":"eve","jti":"0A","exp":99999999999,"roles":{"a":3}})"})
    EXPECT_FALSE(read(forge(odd, JWT_ALG_ES256, key_))) << odd;
}

TEST_F(Tokens, EndWhileTheyAreKnown) {
  const std::string brief = sign_token({.name = "eve", .serial = "0A", .roles = {Role::observe}},
                                       std::chrono::system_clock::now() + std::chrono::seconds(2), key_);
  EXPECT_TRUE(read(brief));
  std::this_thread::sleep_for(std::chrono::milliseconds(2100));
  EXPECT_FALSE(read(brief));
}

TEST_F(Tokens, FoldersOfThemAreChecked) {
  token("anna", {Role::submit});
  std::ofstream(path("anna") / token_file) << forge(claims("submit"), JWT_ALG_HS256, "secret");
  EXPECT_THAT(complaint(path("anna")), HasSubstr("token: expected a token by the authority of"));
  std::ofstream(path("anna") / token_file) << "";
  EXPECT_THAT(complaint(path("anna")), HasSubstr("token"));
}

TEST_F(Keyring, WorkersShowTheirPartsToWorkersAlone) {
  const auto keys = std::make_shared<const Keys>(load_keys(issue("w1", {Role::work})));
  const worker::PeerServer server("127.0.0.1:0", std::make_shared<worker::PartStore>(1 << 20), keys);
  const auto fetch = [&](const Keys& caller) {
    return raw_call(dial(server.address(), &caller, Role::work), "/gleaner.v1.WorkerPeer/FetchPart");
  };
  EXPECT_TRUE(refused_at_the_door(fetch(own(Role::submit))));
  EXPECT_FALSE(refused_at_the_door(fetch(own(Role::work))));
}

}  // namespace
}  // namespace gleaner::test
